"""When direct light arrives where the points cannot tell scanner and delay apart, but the bench's drawing can."""

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.wall_timing import WallTiming

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
    usable = np.isfinite(arrival_s) & np.isfinite(error_s)
    if usable.sum() < FEWEST_DRAWN:
        return None
    drawn = np.asarray(drawn_m, dtype=np.float64)
    tape_m = TAPE * float(np.linalg.norm(drawn))
    metres = arrival_s * SPEED_OF_LIGHT_M_PER_S / 2
    floor_m = max(float(np.median(error_s[usable])), 1e-13) * SPEED_OF_LIGHT_M_PER_S / 2
    error_m = np.hypot(np.where(usable, error_s, np.inf) * SPEED_OF_LIGHT_M_PER_S / 2, floor_m)

    def off(p: Floats, keep: npt.NDArray[np.bool_]) -> Floats:
        distance = np.sqrt((x_m[keep] - p[0]) ** 2 + (y_m[keep] - p[1]) ** 2 + p[2] ** 2)
        return np.asarray((p[3] + distance - metres[keep]) / error_m[keep])

    def residuals(p: Floats, keep: npt.NDArray[np.bool_]) -> Floats:
        return np.append(off(p, keep), (p[:3] - drawn) / tape_m)

    reach_m = FARTHEST * tape_m
    bounds = (np.append(drawn - reach_m, -np.inf), np.append(drawn + reach_m, np.inf))
    found, kept = np.append(drawn, 0.0), usable
    found[3] = -np.median(off(found, usable) * error_m[usable])
    for step in range(5):
        solved = scipy.optimize.least_squares(
            residuals, found, bounds=bounds, loss="linear" if step else "soft_l1", f_scale=2.0, x_scale=[tape_m] * 4,
            args=(kept,), max_nfev=100,
        )  # fmt: skip
        found, before = solved.x, kept
        apart = np.abs(off(found, usable))
        kept = usable.copy()
        kept[usable] = apart <= 4 * max(1.4826 * float(np.median(apart)), 1.0)
        if kept.sum() < FEWEST_DRAWN:
            return None
        if step and (kept == before).all():
            break
    rest, jacobian = off(found, kept), np.asarray(solved.jac, dtype=np.float64)
    information = jacobian.T @ jacobian
    scatter = max(float((rest**2).mean()), 1.0)
    to_seconds = np.diag([1.0, 1.0, 1.0, 2 / SPEED_OF_LIGHT_M_PER_S])
    return WallTiming(
        scanner_position_m=found[:3].copy(),
        delay_s=float(found[3] * 2 / SPEED_OF_LIGHT_M_PER_S),
        covariance=to_seconds @ np.linalg.inv(information) @ to_seconds * scatter,
        rms_s=float(np.sqrt(np.mean((rest * error_m[kept]) ** 2)) * 2 / SPEED_OF_LIGHT_M_PER_S),
        accepted=kept,
        drawn=True,
    )
