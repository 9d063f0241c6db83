"""Scenes and training samples per second at 64 x 64 points and 256 bins, and whether their making holds training up.

Seconds are processor time of one core, so that other work on the machine does not count. The floor is the arithmetic of
the renderer: what the same number of square roots and additions costs with nothing else.
"""

import json
from concurrent.futures import ProcessPoolExecutor
from time import perf_counter, process_time

import numpy as np
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.batches import batch_at
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.network import build, objective
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import Surfels, make_scene, surfels
from nlos.recon.training.train_settings import TrainSettings

WALL, TIME = WallGrid(2.0, 2.0, 64, 64), TimeAxis(256, 64e-12)
SCENES = 24
SEED = 99


def figure(name: str, value: float, unit: str, target: float | None = None, at_most: bool = False) -> None:
    met = None if target is None else bool(value <= target if at_most else value >= target)
    print(json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": target, "met": met}))


def make_scenes(first: int) -> float:
    """Seconds for SCENES scenes with their transients on this core."""
    torch.set_num_threads(1)
    started = process_time()
    for index in range(first, first + SCENES):
        render(_surfels(index), WALL, TIME)
    return process_time() - started


def make_samples(first: int) -> float:
    """Seconds for SCENES samples, detector and truth included, nothing cached."""
    torch.set_num_threads(1)
    settings = DatasetSettings(seed=SEED, degradations=1)
    started = process_time()
    for index in range(first, first + SCENES):
        sample(settings, index)
    return process_time() - started


def _surfels(index: int) -> Surfels:
    return surfels(make_scene(SEED, index, WALL), np.random.default_rng(index))


def floor_s(pairs: int) -> float:
    """Square roots and additions of that many numbers in blocks that stay in the cache."""
    torch.set_num_threads(1)
    block = torch.rand(1 << 17)
    out = torch.empty_like(block)
    started = process_time()
    for _ in range(max(1, pairs // block.numel())):
        torch.sqrt(block, out=out)
        out.add_(block)
    return process_time() - started


def training_step_s() -> float:
    """One step of the plain U-Net, batch of 2, on one core."""
    torch.set_num_threads(1)
    settings = TrainSettings(method="unet", data=DatasetSettings(seed=SEED))
    model = build(settings, WALL, TIME)
    batch = batch_at(settings.data, None, SEED, 0, settings.batch)
    times = []
    for _ in range(4):
        started = process_time()
        objective(model, batch, settings, "cpu")["loss"].backward()  # type: ignore[no-untyped-call]
        times.append(process_time() - started)
    return min(times)


def main() -> None:
    alone = min(make_scenes(0) for _ in range(2))
    figure("scenes_per_second_one_core", SCENES / alone, "1/s", 14)
    pairs = sum(_surfels(index).weight_m2.size for index in range(SCENES)) * WALL.rows * WALL.cols
    figure("rendering_over_floor", alone / floor_s(pairs), "ratio")
    with ProcessPoolExecutor(2) as pool:
        for name, make, target in (("scenes", make_scenes, 28.0), ("samples", make_samples, None)):
            best = min(max(pool.map(make, (0, SCENES))) for _ in range(3))
            figure(f"{name}_per_second_two_cores", 2 * SCENES / best, "1/s", target)
    sample_s, step_s = min(make_samples(0) for _ in range(2)) / SCENES, training_step_s()
    figure("making_a_batch_over_a_training_step", 2 * sample_s / step_s, "ratio", 1.0, at_most=True)
    if torch.cuda.is_available():
        pieces = [_surfels(index) for index in range(SCENES)]
        render(pieces[0], WALL, TIME, device="cuda")
        torch.cuda.synchronize()
        started = perf_counter()
        for piece in pieces:
            render(piece, WALL, TIME, device="cuda")
        torch.cuda.synchronize()
        figure("transients_per_second_gpu", SCENES / (perf_counter() - started), "1/s")


if __name__ == "__main__":
    main()
