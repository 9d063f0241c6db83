"""How fast samples are written and replayed, and in how much memory.

Writing 512-bin histograms, flushed as in a scan, against the floor of the same bytes written to a plain file with as
many fsyncs; replaying them flat out; then a whole 512 x 512 x 2048 scan (2.1 GB) through the writer, for its memory.
"""

import json
import os
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import pixels
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.replay import replay
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.wall import WallGrid
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag

RUNS = 3


def figure(name: str, value: float, unit: str, target: float | None = None, at_least: bool = True) -> None:
    met = None if target is None else bool(value >= target if at_least else value <= target)
    print(json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": target, "met": met}))


def plan_of(side: int, bins: int) -> ScanPlan:
    wall = WallGrid(2.0, 2.0, side, side)
    row, col = np.divmod(np.arange(side * side), side)
    axis = HistogramAxis(bins, 32e-12, 10e-9)
    return ScanPlan(wall, axis, pixels(wall, row, col), np.full(side * side, 0.008), np.zeros(side * side, np.int32))


def histograms_of(bins: int) -> list[Histogram]:
    draw = np.random.default_rng(0)
    return [
        Histogram(draw.poisson(1.0, bins).astype(np.uint32), 32e-12, 10e-9, 0.008, 80_000, 500, HistogramFlag.NONE, 0.1)
        for _ in range(64)
    ]


def write_s(path: Path, plan: ScanPlan, histograms: list[Histogram]) -> float:
    """Seconds to record the whole plan, from the first sample to the last byte."""
    points: list[ScanPoint] = list(plan)
    with RecordingWriter.create(path, plan, Header(), overwrite=True) as writer:
        started = time.perf_counter()
        for point in points:
            writer.write(Sample(point, histograms[point.number % 64], point.number * 0.0084))
        writer.flush()
        return time.perf_counter() - started


def plain_write_s(path: Path, plan: ScanPlan, histograms: list[Histogram]) -> float:
    """The same histograms through plain file writes in the same blocks."""
    block = b"".join(histogram.counts.tobytes() for histogram in histograms)
    started = time.perf_counter()
    with path.open("wb", buffering=0) as file:
        for _ in range(len(plan) // 64):
            file.write(block)
    return time.perf_counter() - started


def replay_s(path: Path) -> float:
    """Seconds to replay everything flat out, CRCs checked."""
    with Recording.open(path) as recording:
        started = time.perf_counter()
        count = sum(1 for _ in replay(recording, speed=None))
        assert count == len(recording.plan)
        return time.perf_counter() - started


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        plan, histograms = plan_of(128, 512), histograms_of(512)
        written_s = min(write_s(path, plan, histograms) for _ in range(RUNS))
        replayed_s = min(replay_s(path) for _ in range(RUNS))
        floor_s = min(plain_write_s(Path(folder) / "plain", plan, histograms) for _ in range(RUNS))
        figure("samples_per_s", len(plan) / written_s, "1/s", 10_000)
        figure("write_over_plain_file", written_s / floor_s, "ratio")
        figure("replay_samples_per_s", len(plan) / replayed_s, "1/s", 50_000)
        (Path(folder) / "plain").unlink()
        large, rich = plan_of(512, 2048), histograms_of(2048)
        large_s = write_s(path, large, rich)
        figure("large_megabytes_per_s", os.path.getsize(path) / large_s / 1e6, "MB/s")
        figure("large_replay_samples_per_s", len(large) / replay_s(path), "1/s")
    rss_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "linux" else 1024**2)
    figure("peak_rss_mb", rss_mb, "MB", 300.0, at_least=False)
    assert "torch" not in sys.modules


if __name__ == "__main__":
    main()
