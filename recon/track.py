"""Where what a film shows is, how large, and how fast it moves: a table with a row a frame, errors included."""

import numpy as np
import numpy.typing as npt

from nlos.recon.local_lines import OF_A_PIXEL, on_line, scatter

Floats = npt.NDArray[np.float64]

SEEN = 0.25
"""Of a frame's brightest pixel: what is dimmer is not taken for the object."""
FITTED, MOST_FITTED, FITTED_S = 5, 9, 0.8
"""Frames around each one through which a straight line gives its velocity: those of so many seconds, but at least and
at most so many."""
COLUMNS = (
    "frame", "time_s", "x_m", "y_m", "z_m", "x_error_m", "y_error_m", "z_error_m",
    "width_m", "height_m", "depth_m",
    "vx_m_per_s", "vy_m_per_s", "vz_m_per_s", "vx_error_m_per_s", "vy_error_m_per_s", "vz_error_m_per_s",
)  # fmt: skip


def track(
    albedo: npt.NDArray[np.floating],  # (F, H, W)
    depth_m: npt.NDArray[np.floating],  # (F, H, W), NaN where nothing is seen
    x_m: Floats,
    y_m: Floats,
    time_s: Floats,
    window: int = 1,
) -> dict[str, Floats]:
    """`COLUMNS`, each (F,); NaN where nothing is seen, or too few frames are around.

    Places are centroids, weighted by brightness, brought onto straight lines through the nearest frames where these
    agree (`local_lines`); their standard errors are from how they scatter from frame to frame, and of a part of a pixel
    besides. Extents are those of an even bar with the same variance. Velocity is the slope of a straight line through
    the nearest frames, none of them beyond a gap in time, its standard error from how all frames scatter about their
    lines, so what does not move evenly has a larger one. `window`: of how many frames each picture is the sum;
    neighbours share photons then, and errors are larger by its root.
    """
    places, extents = np.full((2, 3, len(albedo)), np.nan)
    for frame, (light, depth) in enumerate(zip(albedo, depth_m, strict=True)):
        weight = np.where(np.isfinite(depth) & (light > SEEN * light.max()), light, 0.0).astype(np.float64)
        if not weight.sum() > 0:
            continue
        weight /= weight.sum()
        across, down = np.meshgrid(x_m, y_m)
        for axis, each in enumerate((across, down, np.nan_to_num(depth))):
            places[axis, frame] = mean = float((weight * each).sum())
            extents[axis, frame] = np.sqrt(12 * float((weight * (each - mean) ** 2).sum()))
    slopes, about, span = _lines(places, time_s)
    shown, errors = _steadied(places, time_s, window)
    errors = np.hypot(errors, OF_A_PIXEL * _pitch_m(x_m, y_m))
    columns = [np.arange(len(albedo), dtype=np.float64), time_s, *shown, *errors, *extents]
    columns += [*slopes, *(about[:, None] * np.sqrt(window) / span)]
    return dict(zip(COLUMNS, columns, strict=True))


def _steadied(places: Floats, time_s: Floats, window: int) -> tuple[Floats, Floats]:
    """Places (3, F) by lines, and their standard errors; NaN where nothing is seen."""
    shown, errors = places.copy(), np.full_like(places, np.nan)
    seen = np.flatnonzero(np.isfinite(places[0]))
    there, moments_s, most = places[:, seen].T, time_s[seen], fitted(time_s)
    off_m = scatter(there, moments_s, window)
    for at, frame in enumerate(seen):
        errors[:, frame] = off_m
        if np.isfinite(off_m).all():
            shown[:, frame], errors[:, frame] = on_line(there, moments_s, at, off_m, most, window)
    return shown, errors


def _pitch_m(x_m: Floats, y_m: Floats) -> float:
    return max((float(np.abs(np.diff(each)).mean()) for each in (x_m, y_m) if len(each) > 1), default=0.0)


def fitted(time_s: Floats) -> int:
    """How many frames at these moments give a velocity."""
    pace_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else FITTED_S
    return min(max(FITTED, 2 * round(FITTED_S / max(pace_s, 1e-6) / 2) + 1), MOST_FITTED)


def _lines(places: Floats, time_s: Floats) -> tuple[Floats, Floats, Floats]:
    """Slopes (3, F), the scatter of single places about the lines (3,), and the lines' lever (3, F): the root of the
    sum of squared times about their mean."""
    slopes, span = np.full((2, 3, len(time_s)), np.nan)
    squares, freedom = np.zeros(3), 0.0
    seen, most = np.flatnonzero(np.isfinite(places[0])), fitted(time_s)
    reach_s = most * float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    for frame in seen:
        near = seen[np.argsort(np.abs(seen - frame), kind="stable")[:most]]
        near = near[np.abs(time_s[near] - time_s[frame]) <= reach_s]
        if len(near) < 3:
            continue
        times = time_s[near] - time_s[near].mean()
        lever = float((times**2).sum())
        slope = places[:, near] @ times / lever
        left = places[:, near] - places[:, near].mean(axis=1)[:, None] - slope[:, None] * times
        slopes[:, frame], span[:, frame] = slope, np.sqrt(lever)
        squares += (left**2).sum(axis=1)
        freedom += len(near) - 2
    return slopes, np.sqrt(squares / freedom) if freedom else np.full(3, np.nan), span
