"""The live page: read-only and sealed, one scan or several, and what it says is what the file holds at that moment."""

import json
import os
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag
from tests.scan_texts import COARSE_TO_FINE

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]
Viewing = Callable[..., AbstractContextManager[Any]]
SOAK = bool(os.environ.get("NLOS_SOAK"))
FREE = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 16, cols: 16}
pattern: {kind: circle, points: 90, radius_m: 0.3, x_m: 0.15, y_m: -0.1}
dwell_ms: 5
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""


def test_the_page_is_read_only_and_sealed(nlos: Nlos, viewing: Viewing, tmp_path: Path) -> None:
    (tmp_path / "scan.yaml").write_text(COARSE_TO_FINE)
    assert nlos("scan", "scan.yaml", "-o", "run.h5").returncode == 0
    with viewing("run.h5") as viewer:
        state = viewer.waits(lambda state: state["over"])
        assert (state["samples"], state["planned"], state["skipped"], state["status"]) == (256, 256, 0, "complete")
        assert {method: p["samples"] for method, p in state["pictures"].items()} == {"lct": 256, "nano": 256}
        picture = viewer.ask("picture?method=nano")
        assert (picture["samples"], picture["method"], picture["albedo"]["shape"]) == (256, "nano", [16, 16])
        for place, x_m, y_m in ((0, -0.46875, 0.46875), (255, 0.46875, -0.46875), (119, -0.03125, 0.03125)):
            said = viewer.ask(f"histogram?place={place}")
            assert viewer.array(said["counts"]).shape == (512,)
            # The simulated bench: 2 m before the wall, 0.35 ns of cables.
            direct_ns = 0.35 + 2e9 * np.sqrt(4.0 + x_m**2 + y_m**2) / 299792458.0
            assert said["zero_ns"] == pytest.approx(direct_ns, abs=0.02)
            assert 0.0 < said["masked_ns"] < 0.5
        solid = viewer.ask("solid?method=lct")
        assert (solid["samples"], len(solid["volume"]["shape"])) == (256, 3)
        own = urlsplit(viewer.url).path
        for path in ("histogram?place=256", "histogram?place=x", "histogram", "picture?frame=20", "rates?frame=999",
                     "plan?scan=1", "nothing", "state/more", "histogram?place=99999999999999999999"):  # fmt: skip
            assert viewer.get(own + path)[0] == 404, path
        assert viewer.ask("picture?method=nosuch") == {}
        status, body, headers = viewer.get(own)
        assert status == 200
        assert b"NONCE" not in body
        assert b"http://" not in body
        assert b"https://" not in body
        assert "default-src 'none'" in headers["content-security-policy"]
        for path in ("/", "/state", "/wrong/state", own[:-1], own[:-2] + "/state", "/%ff%fe/state", f"{own[1:]}"):
            assert viewer.get(path)[0] in (400, 403), path
        assert viewer.get(own + "state", host="evil.example")[0] == 403
        for method in ("POST", "PUT", "DELETE", "OPTIONS", "HEAD"):
            assert viewer.get(own + "state", method)[0] == 405


def test_a_finished_scan_is_shown_along_its_time(nlos: Nlos, viewing: Viewing, tmp_path: Path) -> None:
    """Frames are made once, by LCT first, whoever asks for what; each is what a scan of so many points looks like."""
    (tmp_path / "scan.yaml").write_text(COARSE_TO_FINE)
    assert nlos("scan", "scan.yaml", "-o", "run.h5").returncode == 0
    with viewing("run.h5", "--method", "lct") as viewer:
        state = viewer.waits(lambda state: all(state["frames"]))
        assert state["frames"] == [round((k + 1) * 256 / 20) for k in range(20)]
        assert state["frames_version"] == 20
        last, newest = viewer.ask("picture?frame=19"), viewer.ask("picture?method=lct")
        assert np.allclose(viewer.array(last["albedo"]), viewer.array(newest["albedo"]), atol=1e-5)
        for frame in (0, 7, 19):
            rates = viewer.ask(f"rates?frame={frame}")
            assert np.count_nonzero(np.isfinite(viewer.array(rates["rates_hz"]))) == rates["samples"]


def test_scans_at_free_positions_are_watched_too(nlos: Nlos, viewing: Viewing, tmp_path: Path) -> None:
    (tmp_path / "free.yaml").write_text(FREE)
    (tmp_path / "scan.yaml").write_text(COARSE_TO_FINE)
    for name in ("free", "scan"):
        assert nlos("scan", f"{name}.yaml", "-o", f"{name}.h5").returncode == 0
    with viewing("scan.h5", "free.h5", "--method", "lct") as viewer:
        viewer.waits(lambda state: state["over"])
        state = viewer.waits(lambda state: state["over"], scan=1)
        assert (state["run"], state["samples"], state["planned"]) == ("free.h5", 90, 90)
        plan = viewer.ask("plan?scan=1")
        assert (plan["places"], plan["grid"]) == (90, None)
        x_m, y_m = viewer.array(plan["x_m"]), viewer.array(plan["y_m"])
        assert np.allclose(np.hypot(x_m - 0.15, y_m + 0.1), 0.3, atol=1e-6)
        for place in (0, 20, 89):
            said = viewer.ask(f"histogram?scan=1&place={place}")
            direct_ns = 0.35 + 2e9 * np.sqrt(4.0 + x_m[place] ** 2 + y_m[place] ** 2) / 299792458.0
            assert said["zero_ns"] == pytest.approx(direct_ns, abs=0.02)
        assert np.isfinite(viewer.array(viewer.ask("rates?scan=1")["rates_hz"])).all()
        assert np.nanmax(viewer.array(viewer.ask("picture?scan=1&method=lct")["albedo"])) > 0.5
        assert viewer.ask("plan?scan=0")["grid"] == [16, 16]


FLUSHED_EVERY = 64
EVENT_EVERY = 512


def grown(path: Path, plan: ScanPlan, pause_s: float, written: list[int]) -> None:
    """A recording that grows as fast as its watcher may suffer it, events among its samples; `written`: how many."""
    rng = np.random.default_rng(1)
    writer = RecordingWriter.create(path, plan, Header())
    for point in plan:
        counts = rng.poisson(0.2, plan.axis.bins).astype(np.uint32)
        histogram = Histogram(counts, plan.axis.bin_width_s, plan.axis.offset_s, point.dwell_s, 10_000,
                              int(counts.sum()), HistogramFlag.NONE, point.number * 1e-3)  # fmt: skip
        written.append(point.number + 1)
        writer.write(Sample(point, histogram, point.number * 1e-3))
        if point.number % FLUSHED_EVERY == FLUSHED_EVERY - 1:
            writer.flush()
            time.sleep(pause_s)
        if point.number % EVENT_EVERY == 5:
            writer.log("note", f"at point {point.number}", point.number * 1e-3)
    writer.finish(Status.COMPLETE)


def test_what_is_polled_hard_is_what_the_file_holds_at_that_moment(viewing: Viewing, tmp_path: Path) -> None:
    side = 128 if SOAK else 64
    plan = ScanSettings.model_validate(
        {"wall": {"width_m": 1.0, "height_m": 1.0, "rows": side, "cols": side}, "pattern": "serpentine", "dwell_ms": 1,
         "histogram": {"bins": 64, "bin_width_ps": 256, "offset_ns": 10}}
    ).plan()  # fmt: skip
    stop = threading.Event()
    states: list[dict[str, object]] = []
    maps: list[tuple[int, np.ndarray]] = []
    histograms: list[tuple[int, int, np.ndarray]] = []
    written: list[int] = [0]
    failures: list[BaseException] = []
    with viewing("run.h5", "--method", "lct") as viewer:

        def poll() -> None:
            try:
                while not stop.is_set():
                    states.append(viewer.state())
                    if (rates := viewer.ask("rates")).get("rates_hz"):
                        maps.append((rates["samples"], viewer.array(rates["rates_hz"])))
                        assert rates["samples"] <= written[-1]
                        number = min(max(0, rates["samples"] - 1 + len(maps) % 3), len(plan) - 1)  # or still to come
                        place = int(plan.positions.row[number] * side + plan.positions.col[number])
                        one = viewer.ask(f"histogram?place={place}")
                        histograms.append((one["samples"], number, viewer.array(one["counts"])))
            except BaseException as error:
                failures.append(error)
                raise

        pollers = [threading.Thread(target=poll) for _ in range(2)]
        for thread in pollers:
            thread.start()
        try:
            grown(tmp_path / "run.h5", plan, 0.05, written)
        finally:
            stop.set()
            for thread in pollers:
                thread.join()
        last = viewer.waits(lambda state: state["over"])
        assert failures == []
        assert last["samples"] == len(plan)
    with Recording.open(tmp_path / "run.h5") as recording:
        records, events = recording.records, recording.events()
        counts = [sample.histogram.counts for sample in recording.samples()]
    said = [[round(event.bench_s, 3), event.kind, event.text] for event in events]
    rate_hz = (records["total_count"] / records["live_time_s"]).astype(np.float32)
    place = plan.positions.row[records["number"]] * side + plan.positions.col[records["number"]]
    assert last["events"] == said
    assert len({samples for samples, _ in maps}) > 10
    for samples, seen in maps:
        expected = np.full(side * side, np.nan, dtype=np.float32)
        expected[place[:samples]] = rate_hz[:samples]
        assert np.array_equal(seen, expected, equal_nan=True), samples
    for samples, number, seen in histograms:
        assert np.array_equal(seen, counts[number] if number < samples else np.zeros(len(seen))), (samples, number)
    assert len({state["samples"] for state in states}) > 10
    for state in states:
        shown, count = state["events"], state["samples"]
        assert isinstance(shown, list)
        assert isinstance(count, int)
        assert shown == said[: len(shown)]
        # Whatever was said before the flush that brought these samples is there with them.
        assert len(shown) >= len(range(5, count - FLUSHED_EVERY, EVENT_EVERY))
        if count:
            taken = records["taken_s"][count - 1] + records["live_time_s"][count - 1]
            assert state["elapsed_s"] == pytest.approx(float(taken), abs=1e-9)


def test_a_scan_ends_when_its_picture_is_good_enough_and_says_so(nlos: Nlos, tmp_path: Path) -> None:
    (tmp_path / "scan.yaml").write_text(COARSE_TO_FINE)
    assert nlos("scan", "scan.yaml", "--until", "soon").returncode == 2
    answers = [nlos("scan", "scan.yaml", "-o", name, "--until", "stable:0.5", "--json") for name in ("a.h5", "b.h5")]
    taken = [json.loads(done.stdout)["points"] for done in answers if done.returncode == 0]
    assert len(taken) == 2
    assert taken[0] == taken[1] < 256
    with Recording.open(tmp_path / "a.h5") as recording:
        said = [event.text for event in recording.events() if event.kind == "until"]
    assert "is good enough: change" in said[-1]
    assert nlos("scan", "scan.yaml", "-o", "a.h5", "--resume").returncode == 0
    with Recording.open(tmp_path / "a.h5") as recording:
        assert len(recording) == 256
