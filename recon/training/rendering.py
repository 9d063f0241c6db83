"""Confocal transients of hidden surfaces: every surfel's light on every wall point, added up in time bins.

On a CPU the work goes through in blocks of a few surfels times the whole wall that stay in the second-level cache; on
a GPU in large ones. Radiometry of a Lambertian wall and object as in O'Toole et al. 2018, eq. 1, with both cosines.
"""

import torch

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.scenes import Surfels
from nlos.recon.training.shapes import Array
from nlos.recon.training.visibility import spread

CPU_BLOCK = 1 << 17
GPU_BLOCK = 1 << 25


def render(
    surfels: Surfels,
    wall: WallGrid,
    time: TimeAxis,
    *,
    retroreflective: bool = False,
    seen: Array | None = None,
    device: str = "cpu",
) -> torch.Tensor:
    """Expected transient (T, H, W), float32, in arbitrary units; bin k: paths of start + k to start + k + 1 bins.

    Diffuse: albedo cos_object^2 cos_wall^2 / r^4 per area; retroreflective: albedo cos_object cos_wall / r^2.
    Paths outside the time axis are dropped, surfaces facing away from a wall point are dark; so are those of which
    `seen`, made by `visibility.visibility`, says that others stand before them.
    """
    points = wall.rows * wall.cols
    x = torch.as_tensor(wall.x_m(), dtype=torch.float32, device=device)[None, None, :]  # (1, 1, W)
    y = torch.as_tensor(wall.y_m(), dtype=torch.float32, device=device)[None, :, None]  # (1, H, 1)
    offset = torch.arange(points, device=device)[None]
    position = torch.from_numpy(surfels.position_m).to(device)
    normal = torch.from_numpy(surfels.normal).to(device)
    weight = torch.from_numpy(surfels.weight_m2).to(device)
    bins_per_metre = 2 / (SPEED_OF_LIGHT_M_PER_S * time.bin_width_s)
    first = time.start_s / time.bin_width_s
    out = torch.zeros((time.bins + 2) * points, device=device)  # one bin before and one after catch what is outside
    block = max(1, (CPU_BLOCK if torch.device(device).type == "cpu" else GPU_BLOCK) // points)
    for start in range(0, weight.numel(), block):
        p, n, w = (part[start : start + block] for part in (position, normal, weight))
        dx, dy, z = x - p[:, 0, None, None], y - p[:, 1, None, None], p[:, 2, None, None]
        squared = ((dy * dy + z * z) + dx * dx).flatten(1)  # (S, H W) r^2
        facing = ((dy * n[:, 1, None, None] - z * n[:, 2, None, None]) + dx * n[:, 0, None, None]).flatten(1)
        inverse = squared.reciprocal()
        if retroreflective:
            light = facing.clamp_(min=0).mul_(inverse).mul_(inverse).mul_((w * p[:, 2])[:, None])
        else:
            light = facing.clamp_(min=0).mul_(inverse).square_()
            light = light.mul_(inverse).mul_(inverse).mul_((w * p[:, 2] ** 2)[:, None])
        if seen is not None:
            light.mul_(spread(torch.from_numpy(seen[start : start + block]).to(device), wall))
        bin_ = squared.sqrt_().mul_(bins_per_metre).add_(1 - first).clamp_(0, time.bins + 1)
        out.scatter_add_(0, bin_.long().mul_(points).add_(offset).view(-1), light.view(-1))
    return out.view(time.bins + 2, wall.rows, wall.cols)[1:-1]
