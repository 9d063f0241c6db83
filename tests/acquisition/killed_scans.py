"""A scan that may be resumed, what it says that one may rely on, and what it holds: for tests that kill it."""

import multiprocessing
from dataclasses import replace
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.salvage import resume
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.acquisition.scanning.engine import record, scan
from nlos.drivers.bench import BenchSettings, open_bench

FORK = multiprocessing.get_context("fork")


class Acknowledging:
    """A writer that tells another process how many samples it may rely on."""

    def __init__(self, writer: RecordingWriter, told: "Synchronized[int] | None", eager: bool) -> None:
        self.writer, self.told, self.eager = writer, told, eager

    def write(self, sample: Sample) -> None:
        self.writer.write(sample)
        if self.eager:
            self.writer.flush()
        if self.told is not None:
            self.told.value = self.writer.acknowledged


def go_on(
    path: Path, plan: ScanPlan, settings: BenchSettings, told: "Synchronized[int] | None" = None, eager: bool = False
) -> None:
    """What `nlos scan --resume` does."""
    control = ScanControl()
    with open_bench(settings) as bench:
        resumed = resume(path, plan, Header(bench_json=settings.model_dump_json()))
        if resumed.writer is None:
            return
        with resumed.writer as writer:
            samples = scan(plan, bench, taken=resumed.taken, elapsed_s=resumed.elapsed_s, control=control)
            record(samples, Acknowledging(writer, told, eager))
            writer.finish(Status.COMPLETE if control.state is ScanState.COMPLETE else Status.INTERRUPTED)


def facts(path: Path) -> list[tuple[Any, ...]]:
    """What must be equal: point, counts, live time and totals, in the order of the file. Times of day are not."""
    with Recording.open(path) as recording:
        return [
            (s.point, s.histogram.counts.tobytes(), replace(s.histogram, counts=None, gate_opened_s=0.0))  # type: ignore[arg-type]
            for s in recording.samples()
        ]
