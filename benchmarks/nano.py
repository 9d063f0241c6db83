"""NANO: parameters, and the memory and time of one inference at 64 x 64 and 128 x 128 points and 512 bins.

Prints one JSON line a figure; `gpu_ms` only where there is a GPU. The process measures itself: peak memory is that of
everything it ever held, the libraries included.
"""

import json
import resource
import sys
from pathlib import Path
from time import perf_counter

if sys.path and Path(sys.path[0] or ".").resolve() == Path(__file__).resolve().parent:
    sys.path.pop(0)  # or a file here would be taken for the package of its name

import numpy as np
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods.nano import Settings, build
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import make_scene, surfels

WALL, SMALLER = WallGrid(2.0, 2.0, 128, 128), WallGrid(2.0, 2.0, 64, 64)
TIME = TimeAxis(512, 32e-12)


def figure(name: str, value: float, unit: str, target: float) -> None:
    """One line of the result."""
    told = {"figure": name, "value": round(value, 3), "unit": unit, "target": f"<= {target:g}", "met": value <= target}
    print(json.dumps(told), flush=True)


def measurement(wall: WallGrid) -> torch.Tensor:
    """A scan of one of the training scenes, about 10 counts in the brightest bin of a point."""
    scene = make_scene(5, 0, WallGrid(2.0, 2.0, 64, 64))
    expected = render(surfels(scene, np.random.default_rng(0)), wall, TIME)
    expected = 10 * expected / expected.amax(dim=0).mean() + 0.1
    return torch.poisson(expected, generator=torch.Generator().manual_seed(0))[None, None]


def seconds(network: torch.nn.Module, counts: torch.Tensor, runs: int) -> float:
    """The best of some runs."""
    best = float("inf")
    for _ in range(runs):
        begun = perf_counter()
        with torch.inference_mode():
            network(counts)
        if counts.is_cuda:
            torch.cuda.synchronize()
        best = min(best, perf_counter() - begun)
    return best


def main() -> None:
    figure("cpu_64_s", seconds(build(Settings(), SMALLER, TIME), measurement(SMALLER), 3), "s", 1.5)
    network = build(Settings(), WALL, TIME)
    parts = [network] if network.refinement is None else [network, network.refinement.correction]
    figure("parameters_m", sum(p.numel() for part in parts for p in part.parameters()) / 1e6, "million", 4)
    counts = measurement(WALL)
    figure("cpu_s", seconds(network, counts, 3), "s", 10)
    figure("peak_gb", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, "GB", 2)
    if torch.cuda.is_available():
        network, counts = network.cuda(), counts.cuda()
        seconds(network, counts, 3)
        figure("gpu_ms", 1000 * seconds(network, counts, 20), "ms", 50)


if __name__ == "__main__":
    main()
