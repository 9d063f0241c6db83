"""Live reconstruction: how early the first picture is there, what watching costs the scan, how late the last one is.

One JSON line a figure. The overhead compares scans with and without a viewer, in turns, by the points per second of
the scan's own loop; the medians are of pairs of runs.
"""

import json
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SCAN = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 64, cols: 64}
pattern: {kind: coarse_to_fine, batch: 64}
dwell_ms: 1
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""
PAIRS = 3


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        there = Path(folder)
        (there / "scan.yaml").write_text(SCAN)
        # On a bench that runs at the wall clock's pace a viewer competes for nothing but the disk: what it can cost
        # shows in bench time, and in the processor time of the scan's own process.
        plain, watched = [], []
        for number in range(PAIRS):
            plain.append(scan(there, f"plain{number}.h5"))
            watched.append(scan(there, f"watched{number}.h5", "--live"))
        overhead = max(0.0, statistics.median(watched) / statistics.median(plain) - 1)
        fraction, late_s = followed(there)
    figure("first_picture_fraction", fraction, "of the points", 0.1)
    figure("live_overhead", overhead, "of points per second of bench time", 0.02)
    figure("last_point_to_picture_s", late_s, "s", 1.5)


def scan(there: Path, name: str, *options: str) -> float:
    """Seconds of bench time of one scan."""
    done = subprocess.run(
        [sys.executable, "-m", "nlos", "scan", "scan.yaml", "-o", name, "--json", *options],
        cwd=there, capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    answer = json.loads(done.stdout)
    if "live" in answer:
        os.kill(answer["live"]["pid"], signal.SIGKILL)
    return float(answer["bench_s"])


def followed(there: Path) -> tuple[float, float]:
    """A scan replayed at the pace of a real bench: part of its points in the first picture, seconds to the last."""
    follower = subprocess.Popen(
        [sys.executable, "-m", "nlos", "reconstruct", "paced.h5", "--follow", "-o", "live", "--no-volume"],
        cwd=there, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    time.sleep(5)  # its libraries are loaded before a scan's first points are there, as they are on a lab's machine
    subprocess.run(
        [sys.executable, "-m", "nlos", "replay", "plain0.h5", "--speed", "1", "-o", "paced.h5", "-q"],
        cwd=there, stdout=subprocess.DEVNULL, check=True, timeout=300,
    )  # fmt: skip
    ended_s = (there / "paced.h5").stat().st_mtime
    _, said = follower.communicate(timeout=300)
    counts = [int(found) for found in re.findall(r"^(\d+) points:", said, re.MULTILINE)]
    return counts[0] / 4096, (there / "live" / "reconstruction.h5").stat().st_mtime - ended_s


def figure(name: str, value: float, unit: str, target: float) -> None:
    print(
        json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": target, "met": value <= target})
    )


if __name__ == "__main__":
    main()
