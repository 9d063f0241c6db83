"""Lines of equal depth, where they help: on surfaces that slope, and where noise does not tear them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import generic_filter

from nlos.recon.seen import STEP_PIXELS, depth_opacity, visible_depth
from nlos.recon.volume import Reconstruction

STEPS_M = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
MOST_LINES = 12
CALM = 0.2
"""Of the distance between lines: where the median pixel is farther than this from the median around it, noise would
tear the lines."""
FEWEST_PIXELS = 60
"""That slope, or there is nothing to draw lines on."""
SLOPING = 1 / 12
"""Of the distance between lines, from pixel to pixel: what rises less is flat, and a line would wander over it."""


@dataclass(frozen=True)
class Contours:
    """What a picture draws lines on."""

    depth_m: npt.NDArray[np.float64]  # (H, W), calmed; NaN where no line goes
    step_m: float
    """Between one line and the next."""
    levels_m: npt.NDArray[np.float64]


def contours(reconstruction: Reconstruction, limits_m: tuple[float, float]) -> Contours | None:
    """Lines between `limits_m`, `MOST_LINES` at most; None where they would not help, or a single row or column of
    points leaves nothing to draw them on."""
    if min(reconstruction.depth_m.shape) < 2:
        return None
    clear = depth_opacity(reconstruction) > 0.5
    depth_m = np.where(clear, visible_depth(reconstruction), np.nan).astype(np.float64)
    low, high = limits_m
    step_m = next((step for step in STEPS_M if (high - low) / step <= MOST_LINES), STEPS_M[-1])
    calm_m = generic_filter(depth_m, _middle, size=3, mode="constant", cval=np.nan)
    known = np.isfinite(depth_m)
    if known.sum() < FEWEST_PIXELS or float(np.median(np.abs(depth_m - calm_m)[known])) > CALM * step_m:
        return None
    wall = reconstruction.wall
    pitch_m = max(wall.width_m / wall.cols, wall.height_m / wall.rows)
    rise_m = _rise(calm_m)
    whole = known & (rise_m <= STEP_PIXELS * pitch_m)
    if (whole & (rise_m > SLOPING * step_m)).sum() < max(FEWEST_PIXELS, 0.25 * known.sum()):
        return None
    calm_m[~whole] = np.nan
    levels_m = np.arange(np.ceil(low / step_m), np.floor(high / step_m) + 1) * step_m
    return Contours(calm_m, step_m, levels_m)


def _middle(around: npt.NDArray[np.float64]) -> float:
    """The median of what is known around a pixel that is; NaN elsewhere."""
    if np.isnan(around[4]):
        return float("nan")
    return float(np.median(around[np.isfinite(around)]))


def _rise(depth_m: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The largest difference to one of the four neighbours, 0 where there is none."""
    padded = np.pad(depth_m, 1, constant_values=np.nan)
    beside = np.stack([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
    return np.asarray(np.nan_to_num(np.abs(beside - depth_m)).max(axis=0))
