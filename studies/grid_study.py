"""Does one set of weights serve every grid and bin width? Held-out scenes scanned on several, with the same photons.

`python -m studies.grid_study [METHOD] [SCENES]` prints one JSON line a grid: PSNR at the best scale, on its own
pixels and on those of the coarsest grid, and depth.
"""

import json
import sys
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods import find
from nlos.recon.training.losses import psnr
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import Scene, front_view, make_scene, surfels

GRIDS = ((64, 256), (32, 256), (128, 256), (64, 512), (64, 1024))  # points along the wall, bins; the first is trained
FINEST = max(bins for _, bins in GRIDS)
COARSEST = min(points for points, _ in GRIDS)
WINDOW_S = 256 * 64e-12
PEAK_COUNTS = 20.0  # on the trained grid
BACKGROUND = 0.02
WALL_M = 2.0
SEED = 4


@dataclass(frozen=True)
class Reached:
    """What the method reaches on one grid, mean over the scenes."""

    points: int
    bins: int
    psnr: float
    psnr_coarse: float
    """Picture and truth averaged to the coarsest grid's pixels: a finer grid's own have more to tell."""
    depth_mad_m: float


def study(method: str, scenes: int, grids: tuple[tuple[int, int], ...] = GRIDS) -> list[Reached]:
    """Every grid on the same scenes of kinds that no training saw, with as many photons on the same wall; on the same
    points with the same ones, drawn in the finest bins and added up."""
    found = []
    for points, bins in grids:
        wall, time = WallGrid(WALL_M, WALL_M, points, points), TimeAxis(bins, WINDOW_S / bins)
        network = _network(method, wall, time)
        pairs = [_one(network, wall, time, index) for index in range(scenes)]
        decibels, coarse, errors = np.asarray(pairs).T
        means = float(decibels.mean()), float(coarse.mean()), float(np.nanmean(errors))
        found.append(Reached(points, bins, *means))
    return found


def _one(network: nn.Module, wall: WallGrid, time: TimeAxis, index: int) -> tuple[float, float, float]:
    trained = WallGrid(WALL_M, WALL_M, *2 * (GRIDS[0][0],))
    scene = make_scene(SEED, index, trained, held_out=True)
    counts = _counts(scene, wall, index).reshape(time.bins, -1, wall.rows, wall.cols).sum(dim=1)
    with torch.inference_mode():
        albedo, depth_m, _ = network(counts[None, None], None)
    view = front_view(scene, wall)
    truth = torch.from_numpy(view.intensity / max(float(view.intensity.max()), 1e-6))[None]
    seen = torch.from_numpy(view.depth_m)[None]
    error = (depth_m - seen).abs()[(seen > 0) & torch.isfinite(depth_m)]
    together = wall.rows // COARSEST
    coarse_psnr = psnr(F.avg_pool2d(albedo, together), F.avg_pool2d(truth, together))
    return float(psnr(albedo, truth)), float(coarse_psnr), float(error.mean())


def _counts(scene: Scene, wall: WallGrid, index: int) -> torch.Tensor:
    """(FINEST, H, W) photons: `PEAK_COUNTS` in a point's brightest bin of the trained grid, on average, and a
    background."""
    expected = render(surfels(scene, np.random.default_rng((SEED, index))), wall, TimeAxis(FINEST, WINDOW_S / FINEST))
    coarse = expected.reshape(GRIDS[0][1], -1, wall.rows, wall.cols).sum(dim=1)
    photons = PEAK_COUNTS * (GRIDS[0][0] / wall.rows) ** 2
    dark = BACKGROUND * photons * GRIDS[0][1] / FINEST
    rate = expected * (photons / float(coarse.amax(dim=0).mean())) + dark
    return torch.poisson(rate, generator=torch.Generator().manual_seed(index))


@lru_cache(maxsize=2)
def _network(method: str, wall: WallGrid, time: TimeAxis) -> nn.Module:
    chosen = find(method)
    return chosen.build(chosen.Settings(), wall, time).eval()


if __name__ == "__main__":
    name = sys.argv[1] if len(sys.argv) > 1 else "nano"
    for reached in study(name, int(sys.argv[2]) if len(sys.argv) > 2 else 24):
        print(json.dumps({"method": name} | reached.__dict__), flush=True)
