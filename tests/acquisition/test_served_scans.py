"""Whatever can be scanned can be served: every kind of plan, in every scheme, whole, killed, resumed, replaced."""

import dataclasses
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.planning.budget import Budget
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.recording.follow import follow
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.salvage import resume
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.engine import record, scan
from nlos.acquisition.scanning.lag import Lag
from nlos.acquisition.served import server as server_module
from nlos.acquisition.served.far_copy import FarCopy
from nlos.acquisition.served.messages import decode_plan, encode_plan
from nlos.acquisition.served.served_copy import copy_served
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.tcspc.counter import StopAtCounts
from tests.acquisition.serving import serving

SHIPPED = sorted(path.stem for path in (Path(__file__).parents[2] / "configs" / "scan").glob("*.yaml"))
WALL = {"width_m": 0.3, "height_m": 0.3, "rows": 8, "cols": 8}
PLANS: dict[str, dict[str, Any]] = {
    "serpentine": {"wall": WALL},
    "coarse to fine": {"wall": WALL, "pattern": {"kind": "coarse_to_fine", "batch": 8}},
    "circle": {"wall": WALL, "pattern": {"kind": "circle", "points": 48, "radius_m": 0.14}},
    "blue noise": {"wall": WALL, "pattern": {"kind": "blue_noise", "points": 20, "seed": 1}},
    "two passes": {"wall": WALL, "exposure": {"kind": "two_pass", "counts": 2000, "again_ms": 4}},
    "stop at counts": {
        "wall": WALL, "exposure": {"kind": "stop_at_counts", "counts": 20, "from_ns": 11.0, "to_ns": 26.0}
    },
}  # fmt: skip
BENCHES = {"S1": "optotune", "S2": "zero_latency", "S3": "multiharp", "continuous lines": "zero_latency"}
CONTINUOUS = {"wall": {**WALL, "rows": 24, "cols": 24}, "dwell_ms": 0.2, "continuous": {}}
CASES = [(scheme, kind) for scheme in ("S1", "S2", "S3") for kind in PLANS]
CASES.remove(("S3", "stop at counts"))  # the MultiHarp has no such stop


def assert_same(one: Path, other: Path) -> None:
    with Recording.open(one) as a, Recording.open(other) as b:
        assert a.plan == b.plan
        assert a.header == b.header
        assert a.status is b.status
        assert np.array_equal(a.records, b.records)
        assert np.array_equal(a.counts_of(0, len(a)), b.counts_of(0, len(b)))
        assert set(a.events()) <= set(b.events())


def test_every_field_of_a_plan_crosses_the_wire(small_plan: Callable[..., ScanPlan]) -> None:
    """A field that is added to the plan and not to the wire has no other value here, and fails."""
    plan = small_plan()
    other: dict[str, Any] = {"stop": StopAtCounts(20, 3, 40), "revisit_below": 7, "budget": Budget(90_000, 500, 4)}
    given = {"wall", "axis", "positions", "dwell_s", "pass_"}
    for field in dataclasses.fields(plan):
        if field.name not in given | set(other):
            other[field.name] = 0.25e-3
    for name, value in other.items():
        changed = dataclasses.replace(plan, **{name: value})
        assert changed != plan, f"{name} is not in the plan's digest"
        arrived, _ = decode_plan(encode_plan(1, changed, Header()))
        assert arrived == changed
        assert getattr(arrived, name) == value


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_plan_crosses_the_wire(name: str) -> None:
    plan = load("scan", name, ScanSettings).settings.plan()
    assert decode_plan(encode_plan(1, plan, Header(scan_text=name))) == (plan, Header(scan_text=name))


def test_a_scan_that_ends_while_the_server_looks_is_copied_whole(
    bench_settings: Callable[..., BenchSettings], small_plan: Callable[..., ScanPlan], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """All samples and the end come between the server's look at the rows and its answer."""
    run, far, plan = tmp_path / "run.h5", tmp_path / "far.h5", small_plan(dwell_ms=1)
    with open_bench(bench_settings()) as bench:
        samples = list(scan(plan, bench))
    writer = RecordingWriter.create(run, plan, Header())
    refresh, looks = Recording.refresh, list[int]()

    def slowly(recording: Recording) -> int:
        found = refresh(recording)
        looks.append(found)
        if recording.path == run and len(looks) > 3 and not writer.acknowledged:
            for sample in samples:
                writer.write(sample)
            writer.finish(Status.COMPLETE)
        return found

    monkeypatch.setattr(Recording, "refresh", slowly)
    with serving(run, 0, StorageError) as server:
        assert copy_served(server.ticket, far, patience_s=20) == len(plan)
    monkeypatch.undo()
    assert_same(run, far)


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("scheme", "kind"), [*CASES, ("continuous lines", "serpentine")])
def test_every_kind_of_plan_is_served_in_every_scheme(
    scheme: str, kind: str, bench_settings: Callable[..., BenchSettings], small_plan: Callable[..., ScanPlan],
    tmp_path: Path,
) -> None:  # fmt: skip
    """Followed while it is taken, by a copy in a process of its own."""
    run, far = tmp_path / "run.h5", tmp_path / "far.h5"
    step_ps = 320 if scheme == "S3" else 256  # the MultiHarp's bins are 5 ps times a power of two
    bins = {"bins": 64, "bin_width_ps": step_ps, "offset_ns": 9.6 if scheme == "S3" else 10}
    plan = small_plan(
        **(CONTINUOUS if scheme == "continuous lines" else {"dwell_ms": 2, "histogram": bins, **PLANS[kind]})
    )
    forced = Scheme.SWEPT if scheme == "continuous lines" else None
    with open_bench(bench_settings(name=BENCHES[scheme])) as bench:
        writer = RecordingWriter.create(run, plan, Header(scan_text=kind))
        with serving(run, 0, StorageError) as server:
            server.ticket.save(tmp_path / "run.ticket")
            with FarCopy(tmp_path / "run.ticket", far, patience_s=20) as copy:
                bench.on_event = lambda kind, text: writer.log(kind, text)
                record(scan(plan, bench, scheme=forced, lag=Lag(0.12e-3, 0.1)), writer)
                bench.on_event = None
                writer.log("scan", "complete")
                writer.finish(Status.COMPLETE)
                followed = sum(1 for _ in follow(far, patience_s=20))
                copy.check()
    assert_same(run, far)
    assert followed == writer.acknowledged > 0


@pytest.mark.parametrize("status", [status for status in Status if status is not Status.RUNNING])
def test_a_copy_ends_as_its_scan_did(status: Status, small_plan: Callable[..., ScanPlan], tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    RecordingWriter.create(run, small_plan(), Header()).finish(status)
    with serving(run, 0, StorageError) as server:
        copy_served(server.ticket, tmp_path / "far.h5", patience_s=20)
    assert_same(run, tmp_path / "far.h5")


KILLED = """
import os, signal, sys
from pathlib import Path
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.engine import scan
from nlos.acquisition.scanning.lag import Lag
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
plan = ScanSettings.model_validate_json(sys.argv[2]).plan()
with open_bench(load("bench", "zero_latency", BenchSettings).settings) as bench:
    writer = RecordingWriter.create(Path(sys.argv[1]), plan, Header())
    for number, sample in enumerate(scan(plan, bench)):
        writer.write(sample)
        if number == len(plan) // 2:
            writer.flush()
            os.kill(os.getpid(), signal.SIGKILL)
"""
SCAN = (
    '{"wall": {"width_m": 1.0, "height_m": 1.0, "rows": 6, "cols": 6}, "pattern": "serpentine", "dwell_ms": 2, '
    '"histogram": {"bins": 64, "bin_width_ps": 256, "offset_ns": 10}}'
)


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    """A scan of 36 points whose process was killed after the 19th."""
    run = tmp_path / "run.h5"
    done = subprocess.run([sys.executable, "-c", KILLED, str(run), SCAN], timeout=240, check=False)
    assert done.returncode == -signal.SIGKILL
    return run


@pytest.fixture
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """A writer is taken for dead sooner."""
    monkeypatch.setattr(server_module, "LEFT_ALONE_S", 0.5)


@pytest.mark.usefixtures("soon")
def test_a_killed_scan_is_served_to_its_end_and_again_once_resumed(killed: Path, tmp_path: Path) -> None:
    far, plan = tmp_path / "far.h5", ScanSettings.model_validate_json(SCAN).plan()
    with serving(killed, 0, StorageError) as server:
        with pytest.raises(StorageError, match="writer is gone after 19 samples"):
            copy_served(server.ticket, far, patience_s=20)
        assert server.over
        assert verify(far).written == 19
        with open_bench(load("bench", "zero_latency", BenchSettings).settings) as bench:
            resumed = resume(killed, plan, Header())
            assert resumed.writer is not None
            record(scan(plan, bench, taken=resumed.taken, elapsed_s=resumed.elapsed_s), resumed.writer)
            resumed.writer.finish(Status.COMPLETE)
        assert copy_served(server.ticket, far, patience_s=20) == 36
    assert verify(far).complete
    with Recording.open(killed) as a, Recording.open(far) as b:
        assert np.array_equal(a.records, b.records)


@pytest.mark.usefixtures("soon")
def test_a_recording_that_takes_the_served_ones_place_is_never_mixed_with_it(
    small_plan: Callable[..., ScanPlan], killed: Path, tmp_path: Path
) -> None:
    with serving(killed, 0, StorageError) as server:
        with pytest.raises(StorageError, match="writer is gone"):
            copy_served(server.ticket, tmp_path / "far.h5", patience_s=20)
        plan = ScanSettings.model_validate_json(SCAN).plan()
        RecordingWriter.create(killed, plan, Header(scan_text="another"), overwrite=True).finish(Status.INTERRUPTED)
        with pytest.raises((InvalidData, TimeoutError)):
            copy_served(server.ticket, tmp_path / "far.h5", patience_s=2)
    assert verify(tmp_path / "far.h5").written == 19


def test_the_command_ends_for_a_killed_scan_and_so_does_its_follower(killed: Path) -> None:
    nlos = [sys.executable, "-m", "nlos"]
    server = subprocess.Popen(
        [*nlos, "serve", "run.h5", "--idle-s", "12"], cwd=killed.parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    assert server.stdout is not None
    assert "run.ticket" in server.stdout.readline()
    follower = subprocess.run(
        [*nlos, "reconstruct", "run.ticket", "--follow", "-o", "far"], cwd=killed.parent, capture_output=True,
        text=True, timeout=240,
    )  # fmt: skip
    assert follower.returncode == 6, follower.stderr
    assert "writer is gone after 19 samples. Resume the scan" in follower.stderr
    _, said = server.communicate(timeout=240)
    assert server.returncode == 0
    assert "nobody writes it any more" in said
    assert not killed.with_suffix(".ticket").exists()


def test_a_killed_copy_is_resumed_without_a_sample_lost(small_plan: Callable[..., ScanPlan], tmp_path: Path) -> None:
    """What is read through one handle is never written through another of the same process."""
    plan, run, far = small_plan(16, 16), tmp_path / "run.h5", tmp_path / "far.h5"
    with open_bench(load("bench", "zero_latency", BenchSettings).settings) as bench:
        samples = list(scan(plan, bench))
    writer = RecordingWriter.create(run, plan, Header())
    with serving(run, 0, StorageError) as server:
        server.ticket.save(tmp_path / "run.ticket")
        for start in range(0, len(plan), 64):
            for sample in samples[start : start + 64]:
                writer.write(sample)
            writer.flush()
            with FarCopy(tmp_path / "run.ticket", far, patience_s=20) as copy:
                deadline_s = time.monotonic() + 240
                while verify(far).written < writer.acknowledged:
                    assert time.monotonic() < deadline_s
                    time.sleep(0.05)
                os.kill(copy.pid, signal.SIGKILL)
            assert verify(far).corrupt == ()
        writer.finish(Status.COMPLETE)
        assert copy_served(server.ticket, far, patience_s=20) == 256
    assert verify(far).complete
