"""Scans whose laser and sensor points differ, taken for confocal scans of their midpoints: normal moveout.

Light from l to a surface at distance r opposite the midpoint of l and s, and on to s, goes 2 sqrt(r^2 + h^2), with h
half the distance of l and s; a confocal scan of the midpoint would see 2 r. So a path p becomes sqrt(p^2 - (2 h)^2), as
in seismic imaging (Lindell, Wetzstein, O'Toole, "Wave-based non-line-of-sight imaging using fast f-k migration", 2019).
Surfaces that are not opposite the midpoint are put too near, by about x^2 h^2 / (2 r^3) at x aside of it.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FARTHEST = 0.25
"""Pairs of an exhaustive scan farther apart than this share of its grid are skipped: surfaces are not opposite."""
_SAME = 1e-6
"""Of a bin: what coordinates' rounding makes of nothing."""


@dataclass(frozen=True)
class MovedOut:
    """Histograms of the midpoints' grid, from time 0 at the wall, and how many pairs are in each."""

    counts: Array  # (T, A, B)
    grid: Array  # (A, B, 3)
    pairs: Array  # (A, B)
    farthest_m: float
    """The largest distance of laser and sensor point in it."""


def at_midpoints(
    counts: npt.NDArray[np.generic], lasers: Array, sensors: Array, first_m: Array, delta_m: float
) -> MovedOut:
    """Histograms (T, A, B) of sensor points (A, B, 3), each with a laser point of its own (A, B, 3); `first_m` (A, B)
    is the path between wall points at which the first bin begins."""
    apart_m = np.linalg.norm(lasers - sensors, axis=2)
    moved = np.empty(counts.shape)
    for place in np.ndindex(*apart_m.shape):
        moved[:, *place] = moved_out(counts[:, *place], float(apart_m[place]), float(first_m[place]), delta_m)
    return MovedOut(moved, (lasers + sensors) / 2, np.ones(apart_m.shape), float(apart_m.max()))


def of_every_pair(
    counts: npt.NDArray[np.generic], lasers: Array, sensors: Array, first_m: Array, delta_m: float
) -> MovedOut:
    """Histograms (T, A, B, A, B) of every pair of one grid's points (A, B, 3), added up at their midpoints, a grid of
    half its spacing; `first_m` (A, B, A, B). Pairs far apart are skipped."""
    bins, rows, cols = counts.shape[0], *sensors.shape[:2]
    reach_m = FARTHEST * float(np.linalg.norm(np.ptp(sensors.reshape(-1, 3), axis=0)) / np.sqrt(2))
    moved, grid = np.zeros((bins, 2 * rows - 1, 2 * cols - 1)), np.zeros((2 * rows - 1, 2 * cols - 1, 3))
    pairs, farthest_m = np.zeros(grid.shape[:2]), 0.0
    for i, j in np.ndindex(rows, cols):
        for k, n in np.ndindex(rows, cols):
            grid[i + k, j + n] = (lasers[i, j] + sensors[k, n]) / 2
            apart_m = float(np.linalg.norm(lasers[i, j] - sensors[k, n]))
            if apart_m <= reach_m:
                moved[:, i + k, j + n] += moved_out(counts[:, i, j, k, n], apart_m, float(first_m[i, j, k, n]), delta_m)
                pairs[i + k, j + n] += 1
                farthest_m = max(farthest_m, apart_m)
    return MovedOut(moved, grid, pairs, farthest_m)


def moved_out(counts: npt.NDArray[np.generic], apart_m: float, first_m: float, delta_m: float) -> Array:
    """One histogram (T,) whose first bin begins at path `first_m`, in bins of `delta_m` from 0 of the confocal path.
    Counts go where their time goes; those of paths shorter than `apart_m`, which no light takes, are gone. Whole counts
    of a laser point that is the sensor point stay whole, so that they are still known for photons."""
    late = first_m / delta_m
    if apart_m <= _SAME * delta_m and abs(late - round(late)) < _SAME:
        return _delayed(np.asarray(counts, dtype=np.float64), round(late))
    edges_m = np.sqrt((np.arange(len(counts) + 1) * delta_m) ** 2 + apart_m**2)
    so_far = np.concatenate([[0.0], np.cumsum(counts, dtype=np.float64)])
    return np.diff(np.interp((edges_m - first_m) / delta_m, np.arange(len(counts) + 1), so_far))


def _delayed(counts: Array, bins: int) -> Array:
    """The histogram (T,) so many bins later, or earlier where `bins` is below 0; what leaves it at an end is gone."""
    moved, kept = np.zeros_like(counts), max(len(counts) - abs(bins), 0)
    moved[max(bins, 0) : max(bins, 0) + kept] = counts[max(-bins, 0) : max(-bins, 0) + kept]
    return moved
