"""The light that the surface of a picture sends to points of the wall, and the way back: sums of light over its paths.

Radiometry of O'Toole et al. 2018, eq. 1, with both cosines: a pixel is one surfel, turned as its neighbours' depths
say. Lengths in wall widths, times as depths of bins.
"""

from collections.abc import Iterator
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

BLOCK = 1 << 17  # pairs of a point and a pixel at a time: what stays in a processor's cache
BLOCK_OF_GPU = 1 << 23  # which waits for whoever starts its work
STEEP, SOFT = 1.0, 0.1  # pixels that neighbours may differ in depth and still be one surface, and how sharp that is


class Surface(NamedTuple):
    """Pixels of a picture that take part, (M,) each: where, how they are turned, how bright."""

    row: Tensor
    col: Tensor
    x: Tensor
    y: Tensor
    z: Tensor
    across: Tensor  # dz/dx
    up: Tensor  # dz/dy
    albedo: Tensor


class Axis(NamedTuple):
    """Bins of depth: where the first begins and how deep each is, in wall widths."""

    first: float
    bin: float
    bins: int


class Paths(NamedTuple):
    """From N points to M pixels and back, (N, M) each: the share of a pixel's brightness that arrives, the bins of
    block x bins between whose middles it does and how far from the lower one's, and how the path grows with depth."""

    light: Tensor
    place: Tensor
    part: Tensor
    deeper: Tensor


def surface_of(albedo: Tensor, depth: Tensor, seen: Tensor, taken: Tensor, x: Tensor, y: Tensor) -> Surface:
    """The pixels `taken` (H, W) of a picture, their depths those of the nearest ones `seen` where they have none;
    x (W,) and y (H,) are their places."""
    z = nearest(depth, seen, F.max_pool2d(taken.to(depth)[None], 3, 1, 1)[0] > 0)
    across, up = _slope(z, x), _slope(z.T, y).T
    row, col = torch.nonzero(taken, as_tuple=True)
    return Surface(row, col, x[col], y[row], z[row, col], across[row, col], up[row, col], albedo[row, col])


def nearest(values: Tensor, known: Tensor, wanted: Tensor) -> Tensor:
    """(H, W) with the means of known neighbours in place of what is not known, ring by ring until all that are `wanted`
    have one; 0 where nothing is."""
    share = known.to(values)[None, None]
    filled = torch.where(known, values, 0.0)[None, None]
    while bool((wanted & (share == 0)).any()):
        count, total = F.avg_pool2d(share, 3, 1, 1), F.avg_pool2d(filled * share, 3, 1, 1)
        new = (share == 0) & (count > 0)
        if not bool(new.any()):
            break
        filled = torch.where(new, total / count.clamp(min=1e-9), filled)
        share = torch.where(new, 1.0, share)
    return filled[0, 0]


def _slope(z: Tensor, at: Tensor) -> Tensor:
    """Along the columns of (H, W), which are at (W,): the mean of the steps to either side that stay on one surface."""
    pitch = at.diff()
    step = z.diff(dim=1) / pitch
    joined = ((STEEP + SOFT - step.abs()) / (2 * SOFT)).clamp(0, 1)  # no rounding decides
    step = step * joined
    total = F.pad(step, (1, 0)) + F.pad(step, (0, 1))
    return total / (F.pad(joined, (1, 0)) + F.pad(joined, (0, 1))).clamp(min=1)


def blocks(points: int, pixels: int, device: torch.device) -> Iterator[slice]:
    """Points that are done at a time."""
    step = max(1, (BLOCK if device.type == "cpu" else BLOCK_OF_GPU) // max(pixels, 1))
    for start in range(0, points, step):
        yield slice(start, min(points, start + step))


def paths(surface: Surface, x: Tensor, y: Tensor, axis: Axis, falloff: float) -> Paths:
    """To the points at x, y (N,). `falloff` 4 is a diffuse surface, 2 a retroreflective one."""
    dx, dy = x[:, None] - surface.x, y[:, None] - surface.y
    squared = dx.square() + dy.square() + surface.z.square()
    facing = (surface.z + dx * surface.across + dy * surface.up).clamp_(min=0)  # over its value from the front
    light = facing * surface.z / squared  # both cosines
    light = light / squared if falloff == 2 else light.square() / squared.square()
    radius = squared.sqrt()
    at = ((radius - axis.first) / axis.bin - 0.5).clamp_(0, axis.bins - 1.001)
    lower = at.floor()
    place = lower.long() + torch.arange(len(x), device=x.device)[:, None] * axis.bins
    return Paths(light, place, at - lower, surface.z / radius)


def arriving(way: Paths, albedo: Tensor, axis: Axis) -> Tensor:
    """(N, bins): what pixels so bright (M,) send."""
    sent = way.light * albedo
    later = sent * way.part
    out = sent.new_zeros(len(sent) * axis.bins)
    place = way.place.view(-1)
    out.scatter_add_(0, place, (sent - later).view(-1)).scatter_add_(0, place + 1, later.view(-1))
    return out.view(len(sent), axis.bins)


def along(way: Paths, field: Tensor) -> tuple[Tensor, Tensor]:
    """A field (N, bins) where each path arrives, and how much it grows a bin later, (N, M) each."""
    flat = field.reshape(-1)
    here, later = flat[way.place], flat[way.place + 1]
    growth = later - here
    return here + way.part * growth, growth
