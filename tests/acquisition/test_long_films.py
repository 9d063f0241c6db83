"""A film of very many frames: memory stays flat while it is taken, each frame is found at once, kills lose nothing.

`NLOS_SOAK=1` takes 10,000 frames; without it a few.
"""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from itertools import pairwise
from multiprocessing.sharedctypes import Synchronized, SynchronizedArray
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.frames import frame_table, rows_of
from nlos.acquisition.recording.layout import Status
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.salvage import resume
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.scanning.engine import record, scan
from nlos.drivers.bench import BenchSettings, open_bench
from tests.acquisition.killed_scans import Acknowledging

SOAK = os.environ.get("NLOS_SOAK") == "1"
FRAMES, PARTS, POINTS = 10_000 if SOAK else 64, 4, 4
KILLS = 8 if SOAK else 1
DEADLINE_S = 4 * 3600 if SOAK else 120
GROWTH_BYTES = 8 << 20
FORK = multiprocessing.get_context("fork")


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


class _Watched(Acknowledging):
    """Keeps the most memory that the process held in each sixteenth of the film."""

    def __init__(self, *known: object, most: "SynchronizedArray[int]", planned: int) -> None:
        super().__init__(*known)  # type: ignore[arg-type]
        self._most, self._planned, self._written = most, planned, 0

    def write(self, sample: object) -> None:
        super().write(sample)  # type: ignore[arg-type]
        self._written += 1
        if self._written % 8 == 0:
            part = sample.point.number * len(self._most) // self._planned  # type: ignore[attr-defined]
            self._most[part] = max(self._most[part], _resident_bytes())


def _take(
    path: Path,
    plan: ScanPlan,
    settings: BenchSettings,
    told: "Synchronized[int] | None",
    most: "SynchronizedArray[int]",
) -> None:
    with open_bench(settings) as there:
        resumed = resume(path, plan, Header(bench_json=settings.model_dump_json()), clock=there.clock)
        assert resumed.writer is not None
        with resumed.writer as writer:
            watched = _Watched(writer, told, False, most=most, planned=len(plan))
            record(scan(plan, there, taken=resumed.taken, elapsed_s=resumed.elapsed_s), watched)
            writer.finish(Status.COMPLETE)


@pytest.mark.soak
def test_a_film_of_very_many_frames(
    bench_settings: Callable[..., BenchSettings], small_plan: Callable[..., ScanPlan], tmp_path: Path
) -> None:
    plan = small_plan(4, 4, frames=FRAMES, interleave=PARTS, dwell_ms=0.4)
    settings, killed, whole = bench_settings(name="simulated"), tmp_path / "killed.h5", tmp_path / "whole.h5"
    assert (plan.frames, len(plan)) == (FRAMES, FRAMES * POINTS)
    until = time.monotonic() + DEADLINE_S

    for kill in range(KILLS + 1):
        told, wanted = FORK.Value("Q", 0), (kill + 1) * len(plan) // (KILLS + 1)
        child = FORK.Process(target=_take, args=(killed, plan, settings, told, FORK.Array("Q", 16)))
        child.start()
        while kill < KILLS and child.is_alive() and told.value < wanted and time.monotonic() < until:
            time.sleep(0.001)
        if kill < KILLS:
            relied = told.value
            assert child.pid is not None
            os.kill(child.pid, signal.SIGKILL)
        child.join(max(until - time.monotonic(), 1))
        assert child.exitcode == (-signal.SIGKILL if kill < KILLS else 0)
        found = verify(killed)
        assert found.intact
        if kill < KILLS:
            assert len(plan) - len(found.missing) >= relied >= wanted
    most = FORK.Array("Q", 16)
    _in_a_child(_take, whole, plan, settings, None, most, deadline_s=until - time.monotonic())
    held = [each for each in most if each]
    assert len(held) == 16
    # The first sixteenth loads libraries and fills queues.
    assert max(held[2:]) - held[1] < GROWTH_BYTES, [round(each / 1e6, 1) for each in held]

    assert verify(killed).complete_frames == verify(whole).complete_frames == FRAMES
    with Recording.open(killed) as one, Recording.open(whole) as other:
        records = one.intact_records()
        table = frame_table(plan, records)
        assert (table.points == POINTS).all()
        assert all(later > earlier for earlier, later in pairwise(table.mean_s.tolist()))
        for frame in {0, 1, FRAMES // 3, FRAMES // 2, FRAMES - 1}:
            alone = range(frame, frame + 1)
            assert len(rows_of(plan, records, alone)) <= POINTS + 64  # and what a kill had a block of
            assert np.array_equal(one.transient(alone).counts, other.transient(alone).counts)
            assert one.transient(alone).counts.any()


def _in_a_child(work: Callable[..., None], *known: object, deadline_s: float) -> None:
    child = FORK.Process(target=work, args=known)
    child.start()
    child.join(deadline_s)
    if child.is_alive():
        child.kill()
    assert child.exitcode == 0
