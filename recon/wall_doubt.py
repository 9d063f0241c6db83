"""Where points of the wall would help a picture most: its intervals, for new points sent back through the light cone.

Both maps were tried on scenes of the kinds that were learned on (decision 315): more even ones gain less, more uneven
ones lose on some scenes what they gain on others, as every point sees the whole scene.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.recon.volume import Reconstruction

CELLS = 32
"""A side of the picture that is looked at: finer ones are averaged."""
GENTLY = 0.3
"""New points lie as densely as this power of the doubt that they see."""
LEAST = 0.02
"""Of the mean width: no point is skipped for good."""

Floats = npt.NDArray[np.float64]
Map = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Wanted:
    """How many times as densely as on average points should lie, (H, W) each, mean 1, everywhere above 0."""

    new: Map
    """Of points that nobody measured: by the squared widths of brightness intervals as light of each pixel's surface
    arrives, 1 / r^4."""
    again: Map
    """Of points that are measured once more: by the width of the interval at the pixel before them."""


def wanted_on_wall(made: Reconstruction) -> Wanted | None:
    """What the intervals of a picture ask for. None without intervals, or where nothing is seen."""
    if made.intervals is None:
        return None
    wall = made.wall
    width = (made.intervals.albedo_high - made.intervals.albedo_low).astype(np.float64)
    depth_m = made.depth_m.astype(np.float64)
    if not (np.isfinite(depth_m).any() and np.isfinite(width).all() and width.any()):
        return None
    depth_m = np.where(np.isfinite(depth_m), depth_m, np.nanmedian(depth_m))
    x_m, y_m = np.meshgrid(wall.x_m(), wall.y_m())
    doubt, depth, x, y = (_coarser(each).ravel() for each in (width**2, depth_m, x_m, y_m))
    seen = np.zeros(x_m.shape)
    for row in range(len(seen)):  # a row at a time: memory grows with the wall's width alone
        away = (x_m[row][:, None] - x) ** 2 + (y_m[row][:, None] - y) ** 2 + depth**2
        seen[row] = (doubt / away**2).sum(axis=1)
    return Wanted(_evened(seen**GENTLY), _evened(width + LEAST * width.mean()))


def _evened(density: Floats) -> Map:
    return np.asarray(density / density.mean(), dtype=np.float32)


def _coarser(image: Floats) -> Floats:
    """Means over blocks, at most `CELLS` a side."""
    rows, cols = (-(-side // CELLS) for side in image.shape)
    high, wide = image.shape[0] // rows * rows, image.shape[1] // cols * cols
    return np.asarray(image[:high, :wide].reshape(high // rows, rows, wide // cols, cols).mean(axis=(1, 3)))
