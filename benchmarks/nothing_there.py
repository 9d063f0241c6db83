"""Whether pictures of nothing say so: empty scenes, noise alone, wrong walls and time zeros; a hundred scans by NANO.

Twenty-five each, 32 x 32 points, of scenes of kinds that NANO never saw: no light but a sloping background; points
shuffled in time (all of a scan's photons, nothing of its light cones); a wall said to be half or twice as wide; a time
zero off by 0.7 to 2 ns. A scan passes where `seen` is above 0.5 on at most one pixel in a thousand, or the picture is
labelled as explaining nothing. One JSON line a figure; cases go to stderr. Number of scans of a kind as argument.
"""

import json
import sys
from dataclasses import replace

import numpy as np

from nlos.acquisition.transient import Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.reconstruct import reconstruct
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings

DATA = DatasetSettings(
    seed=515, rows=32, cols=32, degradations=1, scenes=1000, held_out=True, detector=DetectorSettings(sparse=0.0)
)
SEEN, MOST = 0.5, 0.001
KINDS = ("empty", "noise", "wrong_wall", "wrong_time_zero")


def scan(kind: str, number: int) -> Transient:
    """One scan that shows nothing, or shows it wrongly."""
    rng = np.random.default_rng((KINDS.index(kind), number))
    made = sample(DATA, 4 * number + KINDS.index(kind))
    counts = made.counts.astype(np.float32)
    scan = Transient(counts, made.exposure.astype(np.float64), DATA.wall, DATA.time)
    if kind == "empty":
        level = np.exp(rng.uniform(np.log(0.01), np.log(8))) * np.linspace(1 + rng.uniform(-0.2, 0.2), 1, DATA.bins)
        light = level[:, None, None] * made.exposure
        return replace(scan, counts=rng.poisson(light).astype(np.float32))
    if kind == "noise":
        return replace(scan, counts=rng.permuted(counts, axis=0))
    if kind == "wrong_wall":
        wide = DATA.wall_width_m * (0.5 if number % 2 else 2.0)
        return replace(scan, wall=WallGrid(wide, wide, DATA.rows, DATA.cols))
    later = round(rng.uniform(0.7e-9, 2e-9) * (1 if number % 2 else -1) / DATA.time.bin_width_s)
    moved = np.roll(counts, later, axis=0)
    moved[: max(later, 0)] = 0
    moved[DATA.bins + min(later, 0) :] = 0
    return replace(scan, counts=moved)


def main(each: int) -> None:
    for kind in KINDS:
        passed = quiet = labelled = 0
        for number in range(each):
            made = reconstruct(scan(kind, number), "nano")
            assert made.intervals is not None
            assert made.explained is not None
            share = float((made.intervals.seen > SEEN).mean())
            quiet += share <= MOST
            labelled += made.explained.nothing
            passed += share <= MOST or made.explained.nothing
            print(json.dumps({kind: number, "seen": round(share, 4), "said": str(made.explained)}), file=sys.stderr)
        for name, count in (("passed", passed), ("not_seen", quiet), ("labelled", labelled)):
            target = 1.0 if name == "passed" else None
            met = None if target is None else count == each
            line = {"figure": f"{kind}_{name}", "value": count / each, "unit": "of the scans", "target": target}
            print(json.dumps({**line, "met": met}), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 25)
