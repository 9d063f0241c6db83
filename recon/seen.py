"""What counts as seen in a picture, and how its depths are coloured: one rule for every picture and view."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from nlos.acquisition.wall import WallGrid
from nlos.recon.volume import Reconstruction

Floats = npt.NDArray[np.float32]

FAINT = 0.02
"""Of the brightest point: below this nothing counts as seen, in every picture and view (decision 135)."""
FULL = 0.35
"""From this brightness on a depth has its full colour; between `FAINT` and this it fades."""
SOLID = 0.15
"""In 3D a point is there or is not: at first from where a depth has about half its colour, by hand down to `FAINT`."""
SURE = 0.1
"""The depths of points as bright as this set the limits of the colours."""
DOUBTFUL = 0.5
"""Less likely a surface than this: hatched in the front view."""
STEP_PIXELS = 4.0
"""Neighbours farther apart in depth than this many pixels belong to different surfaces."""
NEIGHBOURS = 3
"""Of eight. A pixel dimmer than `FULL` that has fewer at its depth is noise: a surface has an extent (decision 235)."""


def depth_span(reconstructions: Sequence[Reconstruction]) -> tuple[float, float] | None:
    """Nearest and farthest, in metres, of the middle 96 % of the depths of points that are bright enough; None where no
    point is."""
    depths = [visible_depth(made)[made.albedo >= SURE * brightest(made)] for made in reconstructions]
    sure = np.concatenate([each[np.isfinite(each)] for each in depths]) if depths else np.zeros(0)
    if not sure.size:
        return None
    low, high = (float(each) for each in np.quantile(sure, [0.02, 0.98]))
    return low, high


def depth_limits(reconstructions: Sequence[Reconstruction]) -> tuple[float, float]:
    """The ends of the colours common to some pictures, in metres: their `depth_span`, a little more on either side, and
    never closer together than 4 cm."""
    low, high = depth_span(reconstructions) or (0.02, 0.98)
    margin = max(0.02, 0.05 * (high - low))
    return max(0.0, low - margin), high + margin


def depth_opacity(reconstruction: Reconstruction) -> npt.NDArray[np.float32]:
    """How much colour a depth has, (H, W), 0 to 1: none where nothing is seen, a tenth just above `FAINT`; less where
    the method doubts that there is a surface."""
    shade = reconstruction.albedo / brightest(reconstruction)
    seen = np.isfinite(visible_depth(reconstruction))
    opacity = np.where(seen, np.clip(0.1 + 0.9 * (shade - FAINT) / (FULL - FAINT), 0, 1), 0)
    sure = reconstruction.intervals
    return np.asarray(opacity if sure is None else opacity * sure.seen, dtype=np.float32)


def brightest(reconstruction: Reconstruction) -> float:
    """What is drawn as white: the 99.9th percentile of the front view."""
    return white(reconstruction.albedo)


def visible_depth(reconstruction: Reconstruction) -> Floats:
    """`seen_depth` of a reconstruction."""
    return seen_depth(reconstruction.albedo, reconstruction.depth_m, reconstruction.wall)


def white(albedo: Floats) -> float:
    """The 99.9th percentile of a front view."""
    return float(np.quantile(albedo, 0.999)) or 1.0


def seen_depth(albedo: Floats, depth_m: Floats, wall: WallGrid) -> Floats:
    """depth_m (H, W) in metres of what is seen; NaN where the front view is too faint to be told from black, and at
    faint pixels that stand alone."""
    shade = albedo / white(albedo)
    bright = np.where(shade >= FAINT, depth_m, np.float32(np.nan))
    step_m = STEP_PIXELS * max(wall.width_m / wall.cols, wall.height_m / wall.rows)
    joined = (shade >= FULL) | (_neighbours(bright, step_m) >= NEIGHBOURS)
    return np.where(joined, bright, np.float32(np.nan))


def _neighbours(depth_m: npt.NDArray[np.float32], step_m: float) -> npt.NDArray[np.int64]:
    """How many of the eight around each pixel are not farther from its depth than `step_m`."""
    rows, cols = depth_m.shape
    around = np.lib.stride_tricks.sliding_window_view(np.pad(depth_m, 1, constant_values=np.nan), (rows, cols))
    near = np.abs(around - depth_m) <= step_m  # (3, 3, H, W); never where either has no depth
    return np.asarray(near.sum(axis=(0, 1), dtype=np.int64) - near[1, 1])
