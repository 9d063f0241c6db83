"""Light that meets two hidden surfaces on its way: what clutter adds to a confocal transient."""

import numpy as np
import torch

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.scenes import Surfels


def thinned(surfels: Surfels, count: int, rng: np.random.Generator) -> Surfels:
    """At most `count` surfels drawn by their weight, which together weigh what all did."""
    size = surfels.weight_m2.size
    if size <= count:
        return surfels
    total = float(surfels.weight_m2.sum())
    chosen = rng.choice(size, count, p=surfels.weight_m2 / total)
    weight = np.full(count, total / count, np.float32)
    return Surfels(surfels.position_m[chosen], surfels.normal[chosen], weight)


def render_second_bounce(surfels: Surfels, wall: WallGrid, time: TimeAxis) -> torch.Tensor:
    """Expected transient (T, H, W) of wall - surfel - surfel - wall paths, in the units of `rendering.render`.

    Every pair of Lambertian surfels counts, both ways round, without occlusion between them: thin the surfels first
    (`thinned`), the cost grows with their square. A reflection more brings one factor of 1 / pi.
    """
    position, normal = torch.from_numpy(surfels.position_m), torch.from_numpy(surfels.normal)
    weight = torch.from_numpy(surfels.weight_m2)
    x, y = (torch.as_tensor(axis, dtype=torch.float32) for axis in (wall.x_m(), wall.y_m()))
    points = wall.rows * wall.cols
    on_wall = torch.stack((x.repeat(wall.rows), y.repeat_interleave(wall.cols), torch.zeros(points)), dim=1)
    arm = on_wall[None] - position[:, None]  # (S, P, 3)
    length = arm.norm(dim=2)
    lit = (arm @ normal[:, :, None])[..., 0].clamp(min=0) * position[:, 2:] / length**4  # cos cos / r^2
    lit *= weight[:, None]
    between = position[None] - position[:, None]  # (S, S, 3) from i to j
    distance = between.norm(dim=2).clamp(min=1e-3)
    leaving = torch.einsum("ijk,ik->ij", between, normal).clamp(min=0) / distance
    exchange = leaving * leaving.T / distance**2 / torch.pi
    # A pair nearer than its own size would count more than all its light.
    exchange = exchange.clamp(max=1 / float(weight.max().clamp(min=1e-12)))
    bins_per_metre = 1 / (SPEED_OF_LIGHT_M_PER_S * time.bin_width_s)
    first = time.start_s / time.bin_width_s
    offset = torch.arange(points)[None]
    out = torch.zeros((time.bins + 2) * points)
    for i in range(len(weight) - 1):
        path = length[i] + length[i + 1 :] + distance[i, i + 1 :, None]
        bin_ = (path * bins_per_metre - first + 1).clamp_(0, time.bins + 1).long()
        light = 2 * lit[i] * lit[i + 1 :] * exchange[i, i + 1 :, None]
        out.scatter_add_(0, (bin_ * points + offset).view(-1), light.view(-1))
    return out.view(time.bins + 2, wall.rows, wall.cols)[1:-1]
