"""Points that are listed one by one though they lie on a grid: that grid, which holds each where it was taken.

On a grid of another pitch, measured points and gaps would beat with those of the scan.
"""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

OFF = 0.02
"""Steps by which a point may be off its line: coordinates are stored with few digits."""
_ALIKE = 0.005
FEWEST_LINES = 8
FULLEST = 4
"""Times as many places as points, at most: what is scattered over a finer grid than that only happens to lie on it."""


def lattice_of(
    x_m: Floats, y_m: Floats, size_m: tuple[float, float] | None = None
) -> tuple[float, float, int, int] | None:
    """Width and height in metres, rows and columns of the grid about (0, 0) on whose points all of (x_m, y_m) (N,) lie;
    None where there is none. `size_m`: the wall's width and height, where they are known, or how far its outermost
    points are apart."""
    width_m, height_m = (None, None) if size_m is None else size_m
    across, down = _lines(x_m, width_m), _lines(y_m, height_m)
    if across is None or down is None:
        return None
    (width, cols), (height, rows) = across, down
    if min(rows, cols) < FEWEST_LINES or rows * cols > FULLEST * len(x_m):
        return None
    places = np.rint((y_m / height + 0.5) * rows - 0.5) * cols + np.rint((x_m / width + 0.5) * cols - 0.5)
    return (width, height, rows, cols) if FULLEST * len(np.unique(places)) >= rows * cols else None


def _lines(places_m: Floats, side_m: float | None) -> tuple[float, int] | None:
    """The side in metres, and how many lines, evenly spaced about its middle, hold all of the places; None without."""
    places = np.unique(places_m)
    gaps = np.diff(places)
    if not gaps.size or not np.isfinite(gaps).all():
        return None
    first, reach_m = float(places[0]), float(np.abs(places).max())
    pitch_m = float(np.median(gaps[gaps > 0.1 * gaps.max()]))  # the others are one line's rounding
    steps = np.rint((places - first) / pitch_m)
    if steps[-1] < 1:
        return None
    pitch_m, first = (float(value) for value in np.polyfit(steps, places, 1))
    steps = np.rint((places - first) / pitch_m)
    if np.abs(places - first - steps * pitch_m).max() > OFF * pitch_m:
        return None
    if side_m is None:
        count = round(2 * reach_m / pitch_m + 1)
        return (count * pitch_m, count) if _are_centres(places, count * pitch_m, count) else None
    count = round(side_m / pitch_m)
    if count > 0 and _are_centres(places, side_m, count):
        return side_m, count
    wider = (count + 1) * pitch_m  # where the side is said from the first to the last point
    from_first_to_last = abs(side_m - count * pitch_m) < _ALIKE * side_m and _are_centres(places, wider, count + 1)
    return (wider, count + 1) if from_first_to_last else None


def _are_centres(places: Floats, side_m: float, count: int) -> bool:
    """Whether they are centres of so many pixels of a side."""
    at = (places / side_m + 0.5) * count - 0.5
    return bool(np.abs(at - np.rint(at)).max() < 2 * OFF and at.min() > -0.5 and at.max() < count - 0.5)
