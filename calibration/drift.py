"""How far the time zero drifted while a scan was taken, as far as the order of its points tells it from the wall.

A drift moves each point's arrival by when it was taken, wall and scanner by where it lies. Points taken from top to
bottom do both at once, and a drift is a tilt of the wall; points in random order, or taken more than once, tell them
apart. What any smooth surface would explain is left to the wall, so that one that is not quite plane is no drift.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.arrival_rounds import SMALLEST_RADIUS_BINS, TimeOffsets
from nlos.calibration.matched_filter import match
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.wall_timing import WallTiming, fit_wall_timing

Floats = npt.NDArray[np.float64]
LEAST_APART = 0.02
"""Of the variance of time: where less is left beside the points' places, mirrors that swing back late would do, too."""
SURE = 30.0
"""Chi square of three numbers from which on there is a drift: by chance 1e-6."""
OUTLIER, ROUNDS = 4.0, 4
EXAMPLE_S = 10e-12


@dataclass(frozen=True)
class Drift:
    """Of the time zero over a scan, about its mean; or, where `known` is False, that the scan cannot know."""

    known: bool
    first_s: float
    last_s: float
    """When the first and the last point were taken."""
    course_s: Floats  # (3,) of Legendre polynomials 1 to 3 over that time; 0 where not known
    total_s: float
    """The time zero at the last point less that at the first."""
    error_s: float
    significant: bool
    """Whether it is more than chance."""
    like_tilt_rad: float
    like_distance_m: float
    """What a drift of 10 ps would do to the wall, taken for one: lean, and distance."""

    def at_s(self, taken_s: npt.ArrayLike) -> Floats:
        """How much later light arrives that is taken then."""
        place = 2 * (np.asarray(taken_s, dtype=np.float64) - self.first_s) / (self.last_s - self.first_s) - 1
        return np.asarray(np.polynomial.legendre.legval(place, [0.0, *self.course_s]))


def measure_drift(raw: RawPoints, offsets: TimeOffsets) -> Drift | None:
    """The drift, or that it cannot be known; None where nobody says when the points were taken, or without a wall."""
    wall, width_s = offsets.wall, raw.time.bin_width_s
    seen = raw if raw.visits is None else raw.visits
    if wall is None or seen.taken_s is None or not np.ptp(seen.taken_s) > 0:
        return None
    bins, error = (offsets.measured_bins, offsets.error_bins) if seen is raw else _of_visits(raw, seen, offsets)
    off_s = raw.time.start_s + bins * width_s - wall.arrival_s(seen.x_m, seen.y_m)
    keep = np.isfinite(error) & np.isfinite(off_s)
    if not keep.any():
        return None
    first_s, last_s = float(seen.taken_s.min()), float(seen.taken_s.max())
    place = 2 * (seen.taken_s - first_s) / (last_s - first_s) - 1
    error_s = width_s * np.hypot(error, np.median(error[keep]))
    unknown = Drift(False, first_s, last_s, np.zeros(3), 0.0, 0.0, False, *_as_wall(wall, place[keep], seen, keep))
    fit: _Fit | None = None
    for _ in range(ROUNDS):  # what is far off the wall may be the drift: outliers are what is off both
        fit = _fitted(off_s[keep], place[keep], seen.x_m[keep], seen.y_m[keep], error_s[keep])
        if fit is None:
            break
        off = np.full(len(keep), np.inf)
        off[keep] = fit.left_s
        keep = np.abs(off) <= OUTLIER * max(1.4826 * float(np.median(np.abs(fit.left_s))), 1e-15)
    if fit is None:
        return unknown
    ends = np.array([2.0, 0.0, 2.0])[: len(fit.course_s)]  # of the polynomials, the end less the beginning
    return replace(
        unknown,
        known=True,
        course_s=np.pad(fit.course_s, (0, 3 - len(fit.course_s))),
        total_s=float(ends @ fit.course_s),
        error_s=float(np.sqrt(ends @ fit.covariance @ ends)),
        significant=bool(fit.chi_square > SURE),
    )


def without_drift(raw: RawPoints, offsets: TimeOffsets, drift: Drift) -> TimeOffsets:
    """The arrivals as if the time zero had stayed as it was in the scan's mean, with the wall fitted to them."""
    assert raw.taken_s is not None
    width_s, later = raw.time.bin_width_s, drift.at_s(raw.taken_s) / raw.time.bin_width_s
    measured = offsets.measured_bins - later
    wall = fit_wall_timing(
        raw.time.start_s + measured * width_s, offsets.error_bins * width_s, raw.x_m, raw.y_m, offsets.wall
    )
    predicted = offsets.predicted_bins
    if wall is not None:
        predicted = (wall.arrival_s(raw.x_m, raw.y_m) - raw.time.start_s) / width_s
    return replace(
        offsets,
        offset_bins=np.where(offsets.found, offsets.offset_bins - later, predicted),
        measured_bins=measured,
        predicted_bins=predicted,
        wall=wall,
    )


def _of_visits(raw: RawPoints, visits: RawPoints, offsets: TimeOffsets) -> tuple[Floats, Floats]:
    """The arrival of every visit and its error, in bins, near where that point's light arrives in all."""
    rows = {place: row for row, place in enumerate(zip(raw.x_m, raw.y_m, strict=True))}
    point = np.array([rows[place] for place in zip(visits.x_m, visits.y_m, strict=True)])
    share = visits.exposure_s / np.maximum(raw.exposure_s[point], 1e-30)
    centre, background = offsets.offset_bins[point], np.maximum(offsets.background_per_bin[point] * share, 1e-6)
    known = np.isfinite(centre)
    bins, error = np.full(len(point), np.nan), np.full(len(point), np.inf)
    bins[known], error[known] = match(
        visits.counts[known], background[known], centre[known], offsets.response, raw.time.bin_width_s,
        3 * SMALLEST_RADIUS_BINS,
    )  # fmt: skip
    return bins, error


@dataclass(frozen=True)
class _Fit:
    """The drift's course, three coefficients or one, in s."""

    course_s: Floats
    covariance: Floats
    chi_square: float
    left_s: Floats  # (N,): of the arrivals, beside a surface and the drift


def _fitted(off_s: Floats, place: Floats, x_m: Floats, y_m: Floats, error_s: Floats) -> _Fit | None:
    """None where the order of the points does not tell."""
    x, y = ((each - each.mean()) / max(float(np.ptp(each)), 1e-12) for each in (x_m, y_m))
    surface = np.polynomial.polynomial.polyvander2d(x, y, [3, 3])[:, [0, 1, 2, 3, 4, 5, 6, 8, 9, 12]]
    basis, size, _ = np.linalg.svd(surface / error_s[:, None], full_matrices=False)
    basis = basis[:, size > 1e-9 * size[0]]
    off = off_s / error_s
    left_off = off - basis @ (basis.T @ off)
    for order in (3, 1):
        if len(off) < basis.shape[1] + 3 * order:
            continue
        course = np.polynomial.legendre.legvander(place, order)[:, 1:] / error_s[:, None]
        left = course - basis @ (basis.T @ course)
        size = np.sqrt(np.diag(course.T @ course))
        if np.linalg.eigvalsh(left.T @ left / np.outer(size, size))[0] < 1e-6:
            continue
        inverse = np.linalg.inv(left.T @ left)
        centred = course[:, 0] - (1 / error_s) * np.average(place, weights=error_s**-2)
        if 1 / (inverse[0, 0] * float(centred @ centred)) < LEAST_APART:
            continue
        found = inverse @ (left.T @ left_off)
        freedom = max(len(off) - basis.shape[1] - order, 1)
        rest = left_off - left @ found
        variance = max(float((rest**2).sum()) / freedom, 1.0)
        chi_square = float(((left @ found) ** 2).sum()) / variance
        covariance = np.asarray(inverse * variance, np.float64)
        return _Fit(np.asarray(found, np.float64), covariance, chi_square, rest * error_s)
    return None


def _as_wall(wall: WallTiming, place: Floats, seen: RawPoints, keep: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """The lean and the change of distance that a drift of `EXAMPLE_S` over the scan would be taken for, by the way that
    beams of the same angles have to a wall that leans or moves."""
    (sx, sy, sz), x_m, y_m = wall.scanner_position_m, seen.x_m[keep], seen.y_m[keep]
    distance = np.sqrt((x_m - sx) ** 2 + (y_m - sy) ** 2 + sz**2)
    slopes = np.column_stack([x_m - sx, y_m - sy, np.ones_like(x_m), sz / distance]) * (distance / sz)[:, None]
    moved = np.linalg.lstsq(slopes, place / 2 * EXAMPLE_S * SPEED_OF_LIGHT_M_PER_S / 2, rcond=1e-9)[0]
    return float(np.hypot(moved[0], moved[1])), float(abs(moved[2]))
