"""Live reconstruction: how early the first picture is there, what watching costs the scan, how late the last one is.

One JSON line a figure. The overhead compares scans with and without a viewer, in turns. The pictures are NANO's; the
last one, which equals that of the finished recording, is on disk so long after the last point.
"""

import json
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

SCAN = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 64, cols: 64}
pattern: {kind: coarse_to_fine, batch: 64}
dwell_ms: 1
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""
POINTS = 64 * 64
PAIRS = 3


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        there = Path(folder)
        (there / "scan.yaml").write_text(SCAN)
        plain, watched = [], []
        for number in range(PAIRS):
            plain.append(scan(there, f"plain{number}.h5"))
            watched.append(scan(there, f"watched{number}.h5", "--live"))
        bench_s = [statistics.median(run["bench_s"] for run in runs) for runs in (plain, watched)]
        busy_s = [min(run["busy_s"] for run in runs) for runs in (plain, watched)]
        # A bench that runs at the wall clock's pace waits for its instruments for most of the time. What a viewer can
        # take from it is bench time, or processor time of the scan's own process.
        overhead = max(bench_s[1] / bench_s[0] - 1, (busy_s[1] - busy_s[0]) / bench_s[0], 0.0)
        fraction, late_s = followed(there)
    figure("first_picture_fraction", fraction, "of the points", 0.1)
    figure("live_overhead", overhead, "of points per second", 0.02)
    figure("last_point_to_picture_s", late_s, "s", 1.5)


def scan(there: Path, name: str, *options: str) -> dict[str, float]:
    """Bench time of one scan, and the processor time of its process."""
    before_s = os.times().children_user + os.times().children_system
    done = subprocess.run(
        [sys.executable, "-m", "nlos", "scan", "scan.yaml", "-o", name, "--json", *options],
        cwd=there, capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    busy_s = os.times().children_user + os.times().children_system - before_s
    answer = json.loads(done.stdout)
    if "live" in answer:
        os.kill(answer["live"]["pid"], signal.SIGKILL)
    return {"bench_s": float(answer["bench_s"]), "busy_s": busy_s}


def followed(there: Path) -> tuple[float, float]:
    """A scan replayed at the pace of a real bench: the part of its points in the first picture, and the seconds from
    the last point to the picture of all of them."""
    follower = subprocess.Popen(
        [sys.executable, "-m", "nlos", "reconstruct", "paced.h5", "--follow", "--method", "nano", "-o", "live",
         "--no-volume"],
        cwd=there, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    time.sleep(5)  # its libraries are loaded before a scan's first points are there, as they are on a lab's machine
    said: list[tuple[int, float]] = []

    def listen() -> None:
        assert follower.stderr is not None
        for line in follower.stderr:
            if found := re.match(r"(\d+) points:", line):
                said.append((int(found[1]), time.time()))

    listener = threading.Thread(target=listen)
    listener.start()
    subprocess.run(
        [sys.executable, "-m", "nlos", "replay", "plain0.h5", "--speed", "1", "-o", "paced.h5", "-q"],
        cwd=there, stdout=subprocess.DEVNULL, check=True, timeout=300,
    )  # fmt: skip
    ended_s = (there / "paced.h5").stat().st_mtime
    follower.wait(timeout=300)
    listener.join()
    points, at_s = said[-1]
    assert points == POINTS
    return said[0][0] / POINTS, at_s - ended_s


def figure(name: str, value: float, unit: str, target: float) -> None:
    print(
        json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": target, "met": value <= target})
    )


if __name__ == "__main__":
    main()
