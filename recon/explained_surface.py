"""The light that a picture's surface would send to points of the wall: a small renderer of its own, in NumPy.

Radiometry of O'Toole et al. 2018, eq. 1, with both cosines: a pixel is one surfel, turned as its
neighbours' depths say.
"""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.seen import FULL, seen_depth, white

FAINT = 0.005
"""Of the brightest pixel: fainter ones are not rendered."""
NEARER = 0.7
"""Of the depth of the nearest bright pixels: from there on the same brightness would send four times the light."""
TOGETHER = 8
"""Points of the wall whose light is added up at a time: more do not fit the cache."""
Floats = npt.NDArray[np.float32]


def surface_light(
    albedo: Floats, depth_m: Floats, wall: WallGrid, points: npt.NDArray[np.intp], time: TimeAxis, falloff: float
) -> Floats:
    """(T, N): what the surface with brightness and depth (H, W) sends to the wall points (N, 2) of rows and columns.

    `falloff` 4 is a diffuse surface, 2 a retroreflective one. All 0 where nothing is seen.
    """
    out = np.zeros((len(points), time.bins), np.float32)
    z = with_haze(albedo, depth_m, wall)
    across, up = slopes(z, wall)
    row, col = np.nonzero((albedo > FAINT * albedo.max()) & (z > 0))
    x_m, y_m = wall.x_m().astype(np.float32), wall.y_m().astype(np.float32)
    x, y, z, across, up = x_m[col], y_m[row], z[row, col], across[row, col], up[row, col]
    shade = albedo[row, col]
    per_metre, first = 2 / (SPEED_OF_LIGHT_M_PER_S * time.bin_width_s), time.start_s / time.bin_width_s
    for start in range(0, len(points), TOGETHER):
        row, col = points[start : start + TOGETHER].T[..., None]
        dx, dy = x_m[col] - x, y_m[row] - y  # (points, pixels)
        squared = dx * dx + dy * dy + z * z
        r = np.sqrt(squared)
        facing = np.maximum(z + dx * across + dy * up, 0) / r  # cosine at the surface over that of its front view
        light = shade * (facing * z / r) ** (falloff / 2) / squared ** (falloff / 2)
        bin_ = (r * np.float32(per_metre) - np.float32(first)).astype(np.int64)
        inside = (bin_ >= 0) & (bin_ < time.bins)
        bin_ += np.arange(len(row))[:, None] * time.bins
        sums = np.bincount(bin_[inside], weights=light[inside], minlength=len(row) * time.bins)
        out[start : start + TOGETHER] = sums.reshape(-1, time.bins)
    return out.T


def light_from_in_front(
    albedo: Floats, depth_m: Floats, wall: WallGrid, points: npt.NDArray[np.intp], time: TimeAxis, falloff: float
) -> Floats:
    """(N,): what of `surface_light` each point gets from the pixel in front of it."""
    row, col = points.T
    z, shade = with_haze(albedo, depth_m, wall)[row, col], albedo[row, col]
    bin_ = 2 * z / (SPEED_OF_LIGHT_M_PER_S * time.bin_width_s) - time.start_s / time.bin_width_s
    there = (shade > FAINT * albedo.max()) & (z > 0) & (bin_ >= 0) & (bin_ < time.bins)
    return np.where(there, shade / np.where(there, z, 1) ** falloff, 0).astype(np.float32)


def with_haze(albedo: Floats, depth_m: Floats, wall: WallGrid) -> Floats:
    """A depth (H, W) for every pixel: its own where it is seen (`seen.py`), else the median of what is bright, so that
    haze counts. What is faint and much nearer than anything bright is haze, too: it would outshine all else. NaN where
    nothing is seen."""
    seen = seen_depth(albedo, depth_m, wall)
    known = np.isfinite(seen)
    if not known.any():
        return seen
    bright = albedo >= FULL * white(albedo)
    sure = seen[known & bright] if (known & bright).any() else seen[known]
    believed = known & (bright | (seen >= NEARER * np.quantile(sure, 0.02)))
    return np.where(believed, seen, np.median(sure)).astype(np.float32)


def slopes(z: Floats, wall: WallGrid) -> tuple[Floats, Floats]:
    """dz/dx and dz/dy (up) of a depth map (H, W), from neighbours no farther apart in depth than a pixel is wide; 0
    where there are none."""
    pitch_x, pitch_y = wall.width_m / wall.cols, wall.height_m / wall.rows
    return _slope(z, 1, pitch_x), -_slope(z, 0, pitch_y)


def _slope(z: Floats, axis: int, pitch: float) -> Floats:
    step = np.diff(z, axis=axis)
    joined = np.abs(step) < pitch
    step = np.where(joined, step, 0)
    edge = [(0, 0), (0, 0)]
    total, count = np.zeros_like(z), np.zeros_like(z)
    for side in ((1, 0), (0, 1)):
        edge[axis] = side
        total += np.pad(step, edge)
        count += np.pad(joined, edge)
    return np.asarray(total / np.maximum(count, 1) / pitch, dtype=np.float32)
