"""When direct light arrives where the points cannot tell scanner and delay apart, but the bench's drawing can."""

import numpy as np
import numpy.typing as npt
import scipy

from nlos.calibration.wall_timing import TimedPoints, WallTiming

Floats = npt.NDArray[np.float64]
FEWEST_DRAWN = 5
"""Points, where the scanner's place is known but for little: fewer agree by chance."""
TAPE = 0.03
"""Standard error of the drawn place, of its distance from the wall's centre ..."""
FARTHEST = 3.0
"""... of which the scanner is no more than so many off. A hidden object's light comes as from a scanner at half the
distance and less."""


def fit_near_drawing(
    arrival_s: Floats, error_s: Floats, x_m: Floats, y_m: Floats, drawn_m: npt.ArrayLike
) -> WallTiming | None:
    """As `fit_wall_timing`, for a scanner close to `drawn_m` (3,) in wall coordinates: points may lie on one line or
    a circle, or be few. Returns None where fewer than five points have an arrival."""
    if (np.isfinite(arrival_s) & np.isfinite(error_s)).sum() < FEWEST_DRAWN:
        return None
    timed, drawn = TimedPoints.of(arrival_s, error_s, x_m, y_m), np.asarray(drawn_m, dtype=np.float64)
    tape_m = TAPE * float(np.linalg.norm(drawn))

    def residuals(p: Floats, keep: npt.NDArray[np.bool_]) -> Floats:
        return np.append(timed.residuals(p, keep), (p[:3] - drawn) / tape_m)

    def slopes(p: Floats, keep: npt.NDArray[np.bool_]) -> Floats:
        return np.vstack([timed.slopes(p, keep), np.eye(3, 4) / tape_m])

    reach_m = FARTHEST * tape_m
    bounds = (np.append(drawn - reach_m, -np.inf), np.append(drawn + reach_m, np.inf))
    found, kept = np.append(drawn, timed.delay_m(drawn)), timed.usable
    for step in range(5):
        found = scipy.optimize.least_squares(
            residuals, found, slopes, bounds, loss="linear" if step else "soft_l1", f_scale=2.0, x_scale=[tape_m] * 4,
            args=(kept,), max_nfev=100,
        ).x  # fmt: skip
        before, apart = kept, np.abs(timed.residuals(found, timed.usable))
        kept = timed.usable.copy()
        kept[timed.usable] = apart <= 4 * max(1.4826 * float(np.median(apart)), 1.0)
        if kept.sum() < FEWEST_DRAWN:
            return None
        if step and (kept == before).all():
            break
    jacobian, scatter = slopes(found, kept), max(float((timed.residuals(found, kept) ** 2).mean()), 1.0)
    return timed.timing(found, kept, np.asarray(np.linalg.inv(jacobian.T @ jacobian) * scatter), drawn=True)
