"""The histograms of one hidden point, for networks that have learned nothing yet."""

import numpy as np
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid


def shell(wall: WallGrid, time: TimeAxis, photons: float = 20.0) -> torch.Tensor:
    """Light of one point at half a wall width from the wall, seen everywhere, and some background."""
    x, y = np.meshgrid(wall.x_m() - 0.1 * wall.width_m, wall.y_m())
    path_m = 2 * np.sqrt(x**2 + y**2 + (0.5 * wall.width_m) ** 2)
    arrival = path_m / 299792458.0 / time.bin_width_s - 0.5
    rate = photons * np.exp(-0.5 * (np.arange(time.bins)[:, None, None] - arrival) ** 2) + 0.1
    return torch.from_numpy(np.random.default_rng(1).poisson(rate).astype(np.float32))[None, None]
