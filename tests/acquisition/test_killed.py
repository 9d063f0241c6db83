"""A scan whose process is killed at any moment loses nothing that was acknowledged, and resumes to the same counts."""

import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from nlos.acquisition.errors import StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.engine import record, scan
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.clock import RealTimeClock
from nlos.drivers.simulated import bench as simulated_bench
from tests.acquisition.killed_scans import FORK, Acknowledging, facts, go_on

SOAK = os.environ.get("NLOS_SOAK") == "1"
WRITING = tuple(
    f"recording/{name}.py"
    for name in ("writer", "header", "empty_file", "file_bytes", "stored_rows", "watched_file", "rescue", "salvage",
                 "writer_lock")
)  # fmt: skip


def killed_at_sample(count: int, path: Path, plan: ScanPlan, settings: BenchSettings) -> None:
    """Leaves what a scan leaves that is killed when so many samples are acknowledged."""

    class Deadly(Acknowledging):
        def write(self, sample: Sample) -> None:
            super().write(sample)
            if self.writer.acknowledged == count:
                os.kill(os.getpid(), signal.SIGKILL)

    def dies() -> None:
        with open_bench(settings) as bench, RecordingWriter.create(path, plan, Header()) as writer:
            record(scan(plan, bench), Deadly(writer, None, True))

    child = FORK.Process(target=dies)
    child.start()
    child.join()


def kill_at_line(count: int) -> None:
    """From here on, this process dies before the `count`-th line of the files that write recordings."""
    left = [count]

    def on_line(frame: FrameType, event: str, argument: Any) -> Any:
        if event == "line":
            left[0] -= 1
            if left[0] == 0:
                os.kill(os.getpid(), signal.SIGKILL)
        return on_line

    def on_call(frame: FrameType, event: str, argument: Any) -> Any:
        return on_line if frame.f_code.co_filename.endswith(WRITING) else None

    sys.settrace(on_call)


@pytest.mark.soak
@pytest.mark.parametrize("begun", [False, True], ids=["new scan", "resumed scan"])
def test_killed_before_any_line_that_writes_a_4_by_4_scan_and_resumed(
    run_path: Path, small_plan: Any, bench_settings: Any, begun: bool
) -> None:
    plan, settings = small_plan(4, 4), bench_settings()
    undisturbed, half = run_path.with_name("undisturbed.h5"), run_path.with_name("half.h5")
    go_on(undisturbed, plan, settings)
    expected = facts(undisturbed)

    def dies(line: int, path: Path, told: "Synchronized[int]") -> None:
        kill_at_line(line)
        go_on(path, plan, settings, told, True)

    def finished(line: int, path: Path) -> bool:
        told = FORK.Value("q", 0, lock=False)
        child = FORK.Process(target=dies, args=(line, path, told))
        child.start()
        child.join()
        if told.value:
            assert facts(path)[: told.value] == expected[: told.value], f"killed before line {line}"
        return child.exitcode == 0

    killed_at_sample(7, half, plan, settings)
    assert facts(half) == expected[:7]
    # Every call that changes the disk has its own kill in test_bad_disks.py: here are some of the moments in between.
    for line in range(1, 20_000, 41 if SOAK else 1397):
        if begun:
            shutil.copy(half, run_path)
        if finished(line, run_path):
            break
        go_on(run_path, plan, settings)
        assert facts(run_path) == expected, f"killed before line {line}"
        run_path.unlink()
    assert 1000 < line < 19_000


def test_a_disk_that_fills_up_stops_the_scan_and_takes_nothing_away(
    run_path: Path, small_plan: Any, bench_settings: Any
) -> None:
    plan, settings = small_plan(12, 12), bench_settings()
    bytes_per_point = 64 * 4

    def fill_up(outcome: "Synchronized[int]", told: "Synchronized[int]") -> None:
        writer = RecordingWriter.create(run_path, plan, Header())
        size = run_path.stat().st_size
        resource.setrlimit(resource.RLIMIT_FSIZE, (size - 70 * bytes_per_point, resource.RLIM_INFINITY))
        with open_bench(settings) as bench:
            try:
                with writer:
                    bench.on_event = writer.log
                    record(scan(plan, bench), Acknowledging(writer, told, False))
            except StorageError as error:
                assert bench.simulated is not None
                outcome.value = 1 + bench.simulated.shutter_open + 2 * ("samples are safe" not in str(error))
        os._exit(0)

    outcome, told = FORK.Value("q", 0, lock=False), FORK.Value("q", 0, lock=False)
    child = FORK.Process(target=fill_up, args=(outcome, told))
    child.start()
    child.join()
    assert outcome.value == 1
    assert told.value == 64
    with Recording.open(run_path) as recording:
        assert len(list(recording.samples())) >= 64
    go_on(run_path, plan, settings)
    assert verify(run_path).complete


@pytest.mark.parametrize("room", [0, 1000, 20_000])
def test_a_disk_without_room_for_the_whole_scan_is_refused_before_anything_is_written(
    run_path: Path, small_plan: Any, room: int
) -> None:
    def too_small(outcome: "Synchronized[int]") -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
        try:
            RecordingWriter.create(run_path, small_plan(12, 12), Header())
        except StorageError as error:
            outcome.value = 1 if "takes no file that large" in str(error) and " 0.1 MB for 144" in str(error) else 2
        os._exit(0)

    outcome = FORK.Value("q", 0, lock=False)
    child = FORK.Process(target=too_small, args=(outcome,))
    child.start()
    child.join()
    assert outcome.value == 1
    assert not run_path.exists()
    assert not run_path.with_name("run.h5.lock").exists()
    assert not run_path.with_name("run.h5.new").exists()


def test_a_list_mode_scan_killed_after_three_seconds_keeps_what_was_flushed(
    run_path: Path, tmp_path: Path, small_plan: Callable[..., ScanPlan], bench_settings: Any
) -> None:
    """In real time: a sequence of such a scan lasts longer than that, and is flushed while it runs."""
    settings = bench_settings(name="multiharp")
    plan = small_plan(32, 32, histogram={"bins": 64, "bin_width_ps": 320, "offset_ns": 9.6})

    def in_real_time() -> None:
        simulated_bench.VirtualClock = RealTimeClock  # type: ignore[misc]
        go_on(run_path, plan, settings)

    child = FORK.Process(target=in_real_time)
    child.start()
    deadline_s = time.monotonic() + 60.0
    while not run_path.exists() and time.monotonic() < deadline_s:
        time.sleep(0.01)
    child.join(3.0)
    assert child.is_alive()
    child.kill()
    child.join()
    with Recording.open(run_path) as recording:
        kept = recording.acknowledged
    assert kept > 0
    before = facts(run_path)
    assert len(before) >= kept
    go_on(tmp_path / "whole.h5", plan, settings)
    whole = facts(tmp_path / "whole.h5")
    assert before == whole[: len(before)]
    go_on(run_path, plan, settings)
    assert facts(run_path) == whole
    assert verify(run_path).complete
