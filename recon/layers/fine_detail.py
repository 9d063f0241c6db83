"""Pictures of finer walls than a network learned on: what is coarse in them is of the scan with four points as one.

The operator sees a wall in as many cells whatever the scan's points, and learned on 64 x 64 of them and fewer: of a
finer scan it is the halved one's picture that is right in the large, and its own that has the detail (decision 107).
"""

from collections.abc import Callable, Sequence
from typing import TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.acquisition.wall import WallGrid

FINE = 96  # points a side from which on a wall is halved as well
LEAST_MEASURED = 0.5  # of the points: sparser scans lose more than they gain


Network = TypeVar("Network", bound=nn.Module)


def halves(network: Network, wall: WallGrid, build: Callable[[WallGrid], Network]) -> list[Network]:
    """The same network for half as many points a side, with the same numbers also while they are trained; none for a
    wall that is not finer than what networks learned on."""
    if min(wall.rows, wall.cols) < FINE or wall.rows % 2 or wall.cols % 2:
        return []
    half = build(WallGrid(wall.width_m, wall.height_m, wall.rows // 2, wall.cols // 2))
    half.load_state_dict(network.state_dict(), assign=True)
    return [half.eval()]


def in_the_large(
    halved: Sequence[nn.Module], counts: Tensor, exposure: Tensor | None, response: Tensor | None
) -> Tensor | None:
    """What the halved network sees, (B, H / 2, W / 2), in counts (B, 1, T, H, W) and exposure (B, H, W) of four points
    added up; None without one, or where too few points were measured."""
    if not halved or (exposure is not None and float((exposure > 0).float().mean()) < LEAST_MEASURED):
        return None
    added = F.avg_pool3d(counts, (1, 2, 2)) * 4
    exposed = None if exposure is None else F.avg_pool2d(exposure[:, None], 2)[:, 0] * 4
    seen: Tensor = halved[0].to(counts.device)(added, exposed, response).albedo
    return seen


def with_detail(coarse: Tensor | None, fine: Tensor) -> Tensor:
    """`fine` (B, H, W), but as `coarse` (B, H / 2, W / 2) wherever that can tell; as bright at its brightest."""
    if coarse is None:
        return fine
    strengths = _strength(coarse)
    detail = fine - _enlarged(F.avg_pool2d(fine[:, None], 2)[:, 0])
    seen = (_enlarged(coarse * (_strength(fine) / strengths.clamp(min=1e-12))) + detail).clamp(min=0)
    brightest = fine.amax(dim=(1, 2), keepdim=True)
    seen = seen / seen.amax(dim=(1, 2), keepdim=True).clamp(min=1e-12) * brightest
    return torch.where(strengths > 0, seen, fine)


def _strength(x: Tensor) -> Tensor:
    """Root of the mean square, (B, 1, 1)."""
    return x.square().mean(dim=(1, 2), keepdim=True).sqrt()


def _enlarged(x: Tensor) -> Tensor:
    """(B, H, W) -> (B, 2 H, 2 W)."""
    return F.interpolate(x[:, None], scale_factor=2, mode="bicubic", align_corners=False)[:, 0]
