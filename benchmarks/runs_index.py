"""How fast runs are found again: 10,000 recordings of 1,024 points indexed from nothing, brought up to date, searched.

The recordings are copies of one, each with sample, note and start of its own written over it. `--runs N` for fewer.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import pixels
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Status
from nlos.acquisition.recording.run_notes import RunNotes
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.wall import WallGrid
from nlos.configs.load import find
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag
from nlos.runs.index import RunsIndex

SIDE, BINS = 32, 64
SEARCHES = (
    [], ["sample-004217"], ["hat"], ["sample:sample-00421"], ["note:7919"], ["tag:night", "since:2026-03"],
    ["nothing-of-this-name"],
)  # fmt: skip
INDEXED_S, SEARCHED_S = 60.0, 0.2


def figure(name: str, value: float, unit: str, target: float | None = None) -> None:
    met = None if target is None else bool(value <= target)
    print(
        json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": target, "met": met}), flush=True
    )


def spent_s() -> float:
    """Processor time of this process and of its children that have ended."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def template(folder: Path) -> bytes:
    """A recording whose notes hold words of a fixed length, to be written over."""
    wall = WallGrid(1.0, 1.0, SIDE, SIDE)
    row, col = np.divmod(np.arange(SIDE * SIDE), SIDE)
    count = SIDE * SIDE
    plan = ScanPlan(wall, HistogramAxis(BINS, 16e-12, 10e-9), pixels(wall, row, col), np.full(count, 0.008),
                    np.zeros(count, np.int32))  # fmt: skip
    notes = RunNotes("sample-XXXXXX", "Ada", "with a hat, number NNNNNN", ("night",))
    bench = find("bench", "simulated").read_text()
    header = Header(bench_text=bench, bench_json='{"name": "simulated"}', notes=notes).stamped()
    rng = np.random.default_rng(0)
    with RecordingWriter.create(folder / "template.h5", plan, header) as writer:
        for point in plan:
            counts = rng.poisson(2.0, BINS).astype(np.uint32)
            writer.write(Sample(point, Histogram(counts, 16e-12, 10e-9, 8e-3, 80_000, int(counts.sum()),
                                                 HistogramFlag.NONE, 0.0), point.number * 9e-3))  # fmt: skip
        writer.finish(Status.COMPLETE)
    raw = (folder / "template.h5").read_bytes()
    (folder / "template.h5").unlink()
    return raw.replace(header.started_utc.encode(), b"2026-MM-DDT12:00:00.000+00:00")


def make(folder: Path, runs: int) -> None:
    """`runs` files in folders by day."""
    raw = template(folder)
    for number in range(runs):
        day = folder / f"2026-{1 + number // 900:02d}-{1 + number % 28:02d}"
        day.mkdir(exist_ok=True)
        mine = raw.replace(b"XXXXXX", f"{number:06d}".encode()).replace(
            b"NNNNNN", f"{number * 7919 % 10**6:06d}".encode()
        )
        mine = mine.replace(b"2026-MM-DD", day.name.encode())
        (day / f"{number:05d}.h5").write_bytes(mine)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000)
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory(prefix="nlos-runs-") as place:
        folder = Path(place)
        (folder / "data").mkdir()
        make(folder / "data", runs)
        os.environ["NLOS_STATE"] = str(folder / "state")
        with RunsIndex(folder / "data") as index:
            start_s, spent_before_s = time.perf_counter(), spent_s()
            changes = index.update()
            figure(f"{changes.read} recordings indexed", time.perf_counter() - start_s, "s", INDEXED_S)
            figure("processors' time of it, all processes", spent_s() - spent_before_s, "s")
            assert changes.unreadable == 0
            assert index.count() == runs
            start_s = time.perf_counter()
            index.update()
            figure("nothing new: brought up to date", time.perf_counter() - start_s, "s")
            worst_s = 0.0
            for words in SEARCHES:
                start_s = time.perf_counter()
                index.search(words, limit=50)
                worst_s = max(worst_s, time.perf_counter() - start_s)
            figure(f"the slowest of {len(SEARCHES)} searches", worst_s, "s", SEARCHED_S)
            start_s = time.perf_counter()
            with RunsIndex(folder / "data") as again:
                again.update()
                again.search(["sample-004217"], limit=50)
            figure("opened, brought up to date and searched", time.perf_counter() - start_s, "s", SEARCHED_S)
            words = [sys.executable, "-m", "nlos", "runs", "--folder", str(folder / "data"), "sample-004217"]
            start_s = time.perf_counter()
            subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
            figure("`nlos runs WORD`, Python and imports included", time.perf_counter() - start_s, "s")


if __name__ == "__main__":
    main()
