"""How much memory a large recording takes from its file to constants and to a picture, in sizes of its counts.

A recording of 96 x 96 points and 4096 bins (151 MB) is calibrated and reconstructed by the commands, each in a process
of its own, whose peak is told less that of the same command on a scan of 16 x 16 points; the targets are those for a
laboratory's 512 x 512 points on a machine of 16 GB.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import pixels
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.acquisition.wall import WallGrid
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag

BINS, WIDTH_S, DWELL_S = 4096, 8e-12, 0.01
CALIBRATED, RECONSTRUCTED = 3.0, 3.5


def record(path: Path, side: int) -> None:
    """A wall 1.5 m from the scanner, a point behind the corner, even light."""
    wall, draw = WallGrid(1.0, 1.0, side, side), np.random.default_rng(1)
    row, col = np.divmod(np.arange(side * side), side)
    axis, points = HistogramAxis(BINS, WIDTH_S, 0.0), side * side
    plan = ScanPlan(wall, axis, pixels(wall, row, col), np.full(points, DWELL_S), np.zeros(points, np.int32))
    bins = np.arange(BINS) + 0.5
    with RecordingWriter.create(path, plan, Header()) as writer:
        for point in plan:
            direct = 2 * np.sqrt(point.x_m**2 + point.y_m**2 + 1.5**2) / (SPEED_OF_LIGHT_M_PER_S * WIDTH_S)
            later = 2 * np.sqrt((point.x_m - 0.1) ** 2 + point.y_m**2 + 0.8**2) / (SPEED_OF_LIGHT_M_PER_S * WIDTH_S)
            rate = (
                0.02 + 150 * np.exp(-(((bins - direct) / 5) ** 2)) + 5 * np.exp(-(((bins - direct - later) / 5) ** 2))
            )
            counts = draw.poisson(rate).astype(np.uint32)
            told = int(counts.sum()), HistogramFlag.NONE, point.number * DWELL_S
            writer.write(Sample(point, Histogram(counts, WIDTH_S, 0.0, DWELL_S, 100_000, *told), told[2]))


def peak_bytes(*words: str) -> int:
    """Of `nlos` with these words."""
    done = subprocess.Popen(
        [sys.executable, "-m", "nlos", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, used = os.wait4(done.pid, 0)
    done.returncode = os.waitstatus_to_exitcode(status)
    if done.returncode:
        raise subprocess.CalledProcessError(done.returncode, words)
    return used.ru_maxrss * (1024 if sys.platform == "linux" else 1)


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder, side = Path(name), 96
        for points in (16, side):
            record(folder / f"{points}.h5", points)
        for verb, more, target in (
            ("calibrate", ("-o", str(folder / "k.h5")), CALIBRATED),
            ("reconstruct", ("--method", "lct", "-o", str(folder / "seen")), RECONSTRUCTED),
        ):
            small, large = (peak_bytes(verb, str(folder / f"{n}.h5"), *more, "--overwrite") for n in (16, side))
            ratio = (large - small) / (4 * side * side * BINS)
            told = {"value": round(ratio, 3), "unit": "ratio", "target": target, "met": ratio <= target}
            print(json.dumps({"figure": f"{verb}_over_recording", **told}), flush=True)


if __name__ == "__main__":
    main()
