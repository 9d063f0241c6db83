"""Whether pictures of nothing, and of scans whose geometry is wrong, say so; and those of right scans do not. By NANO.

Twenty-five each, 32 x 32 points, of scenes of kinds that NANO never saw: right scans; no light but a sloping
background; points shuffled in time (all of a scan's photons, nothing of its light cones); a wall said to be 0.5 to 2
times as wide as it is; a time zero off by 0.7 to 2 ns; a fifth of the points in each other's places; every second line
reversed. A wrong scan passes where `seen` is above 0.5 on at most one pixel in a thousand, or the picture is labelled:
as explaining nothing, or as of doubtful geometry. A right one passes where nothing is in doubt. One JSON line a figure;
cases go to stderr. Number of scans of a kind as argument.
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
KINDS = ("empty", "noise", "wrong_wall", "wrong_time_zero", "points_mixed_up", "lines_reversed", "right")
WALLS = (0.5, 2.0, 0.64, 1.56, 0.8, 1.25)


def scan(kind: str, number: int) -> Transient:
    """One scan that shows nothing, or shows it wrongly."""
    rng = np.random.default_rng((KINDS.index(kind), number))
    made = sample(DATA, len(KINDS) * number + KINDS.index(kind))
    counts = made.counts.astype(np.float32)
    scan = Transient(counts, made.exposure.astype(np.float64), DATA.wall, DATA.time)
    if kind == "empty":
        level = np.exp(rng.uniform(np.log(0.01), np.log(8))) * np.linspace(1 + rng.uniform(-0.2, 0.2), 1, DATA.bins)
        light = level[:, None, None] * made.exposure
        return replace(scan, counts=rng.poisson(light).astype(np.float32))
    if kind == "noise":
        return replace(scan, counts=rng.permuted(counts, axis=0))
    if kind == "wrong_wall":
        wide = DATA.wall_width_m * WALLS[number % len(WALLS)]
        return replace(scan, wall=WallGrid(wide, wide, DATA.rows, DATA.cols))
    if kind == "points_mixed_up":
        flat = counts.reshape(DATA.bins, -1)
        chosen = rng.permutation(flat.shape[1])[: flat.shape[1] // 5]
        flat[:, chosen] = flat[:, rng.permutation(chosen)]
        return replace(scan, counts=flat.reshape(counts.shape))
    if kind == "lines_reversed":
        counts[:, 1::2] = counts[:, 1::2, ::-1].copy()
        return scan
    if kind == "right":
        return scan
    later = round(rng.uniform(0.7e-9, 2e-9) * (1 if number % 2 else -1) / DATA.time.bin_width_s)
    moved = np.roll(counts, later, axis=0)
    moved[: max(later, 0)] = 0
    moved[DATA.bins + min(later, 0) :] = 0
    return replace(scan, counts=moved)


def main(each: int) -> None:
    for kind in KINDS:
        passed = quiet = labelled = 0
        for number in range(each):
            made = reconstruct(scan(kind, number), "nano", elsewhere=True)
            assert made.intervals is not None
            assert made.explained is not None
            share = float((made.intervals.seen > SEEN).mean())
            quiet += share <= MOST
            told = made.explained.nothing or bool(made.explained.doubt)
            labelled += told
            passed += not made.explained.doubt if kind == "right" else share <= MOST or told
            print(json.dumps({kind: number, "seen": round(share, 4), "said": str(made.explained)}), file=sys.stderr)
        for name, count in (("passed", passed), ("not_seen", quiet), ("labelled", labelled)):
            target = 1.0 if name == "passed" else None
            met = None if target is None else count == each
            line = {"figure": f"{kind}_{name}", "value": count / each, "unit": "of the scans", "target": target}
            print(json.dumps({**line, "met": met}), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 25)
