"""Explained light: what it costs, and whether it ranks pictures as their truth does.

Prints one JSON line a figure: the CPU time it adds to a picture of 64 x 64 points and 512 bins, by method; and with
the folder of scenes with a truth as argument (default ../shared/data/synthetic, skipped where it is not there) the rank
correlation of explained light with PSNR within each scene, over methods and conditions at their defaults.
"""

import json
import sys
from pathlib import Path
from time import process_time

if sys.path and Path(sys.path[0] or ".").resolve() == Path(__file__).resolve().parent:
    sys.path.pop(0)  # or a file here would be taken for the package of its name

import numpy as np
from scipy.stats import spearmanr

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.evaluate import evaluate
from nlos.recon.reconstruct import reconstruct
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import make_scene, surfels

METHODS = ("lct", "fk", "phasor", "backprojection", "lfe", "nano")
CONDITIONS = ("transient", "counts_p20", "counts_p5", "counts_p1", "counts_p5@16x16")
WALL, TIME = WallGrid(2.0, 2.0, 64, 64), TimeAxis(512, 32e-12)


def figure(name: str, value: float, unit: str, target: str, met: bool) -> None:
    """One line of the result."""
    print(
        json.dumps({"figure": name, "value": round(value, 3), "unit": unit, "target": target, "met": met}), flush=True
    )


def scan() -> Transient:
    """A scan of one of the training scenes, about 10 counts in the brightest bin of a point."""
    expected = render(surfels(make_scene(5, 0, WALL), np.random.default_rng(0)), WALL, TIME).numpy()
    expected = 10 * expected / expected.max(axis=0).mean() + 0.1
    counts = np.random.default_rng(0).poisson(expected).astype(np.float32)
    return Transient(counts, np.ones((64, 64)), WALL, TIME)


def seconds(made: Transient, method: str, explain: bool) -> float:
    """The least CPU time of some runs."""
    least = float("inf")
    for _ in range(4):
        begun = process_time()
        reconstruct(made, method, explain=explain)
        least = min(least, process_time() - begun)
    return least


def main(folder: Path) -> None:
    made = scan()
    for method in ("lct", "fk", "nano"):
        share = seconds(made, method, True) / seconds(made, method, False) - 1
        figure(f"explained_costs_{method}", share, "of the picture's time", "<= 0.3", share <= 0.3)
    if not folder.is_dir():
        return
    rows = evaluate([folder], METHODS, CONDITIONS, fixed=True, say=lambda text: None).rows
    ranks = []
    for scene in dict.fromkeys(row.scene for row in rows):
        of = [row for row in rows if row.scene == scene]
        rank = float(spearmanr([row.explained for row in of], [row.psnr for row in of])[0])
        ranks.append(rank)
        figure(f"explained_ranks_{scene}", rank, "rank correlation with PSNR", ">= 0.8", rank >= 0.8)
    mean = float(np.mean(ranks))
    figure("explained_ranks_mean", mean, "rank correlation with PSNR", ">= 0.8", mean >= 0.8)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else Path("../shared/data/synthetic"))
