"""How large the wall is, from direct times alone, for files that do not say: times know the speed of light, so that
coordinates of a wrong scale fit no scanner position."""

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.background import is_flat
from nlos.calibration.constants import Quantity
from nlos.calibration.errors import InvalidData
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.time_offset import measure_time_offsets

Floats = npt.NDArray[np.float64]
TRIED = (0.3, 1.0, 3.0)
WORST_ERROR = 0.02
FEWEST_POINTS = 30


def wall_scale(raw: RawPoints) -> Quantity | None:
    """By what the points' coordinates have to be multiplied, and its standard error; None where the times do not tell
    it to 2 %. Raises `NoDirectPeak` as `measure_time_offsets` does."""
    offsets = measure_time_offsets(raw.counts, raw.x_m, raw.y_m, raw.time, exposed=raw.exposure_s > 0)
    width_s = raw.time.bin_width_s
    return fit_scale(offsets.measured_bins * width_s, offsets.error_bins * width_s, raw.x_m, raw.y_m)


def found_side(raw: RawPoints, side_m: float) -> tuple[float, float] | None:
    """The side of the wall and its standard error in metres, where `side_m` was assumed; None where the scan does not
    tell it: no direct light, too few points, counts that no calibration takes."""
    try:
        raw.check()
        scale = None if is_flat(raw.counts) else wall_scale(raw)
    except InvalidData:
        return None
    return None if scale is None else (scale.value * side_m, scale.error * side_m)


def fit_scale(arrival_s: Floats, error_s: Floats, x_m: Floats, y_m: Floats) -> Quantity | None:
    """Scanner position, delay and scale by least squares with a soft loss; all arrays (N,), errors infinite where there
    is no arrival."""
    seen = np.isfinite(arrival_s) & np.isfinite(error_s)
    if seen.sum() < FEWEST_POINTS:
        return None
    x, y = x_m[seen], y_m[seen]
    path_m = arrival_s[seen] * SPEED_OF_LIGHT_M_PER_S / 2
    extent = float(np.hypot(np.ptp(x), np.ptp(y)))
    if not extent > 0:
        return None
    floor_m = float(np.median(error_s[seen])) * SPEED_OF_LIGHT_M_PER_S / 2
    error_m = np.hypot(error_s[seen] * SPEED_OF_LIGHT_M_PER_S / 2, floor_m)

    def residuals(p: Floats) -> Floats:  # scanner in units of the wall as given, so that the scale stands alone
        distance = p[4] * np.sqrt((x - p[0]) ** 2 + (y - p[1]) ** 2 + p[2] ** 2)
        return np.asarray((p[3] + distance - path_m) / error_m)

    bounds = ([-np.inf, -np.inf, 0.02 * extent, -np.inf, 1e-3], [np.inf, np.inf, np.inf, np.inf, 1e3])
    fits = []
    for scale in TRIED:
        start = np.array([x.mean(), y.mean(), extent, 0.0, scale])
        start[3] = -float(np.median(residuals(start) * error_m))
        fits.append(
            scipy.optimize.least_squares(
                residuals, start, "3-point", bounds, loss="soft_l1", x_scale="jac", max_nfev=300
            )
        )
    best = min(fits, key=lambda fit: float(fit.cost))
    slopes = np.asarray(best.jac, dtype=np.float64)
    information = slopes.T @ slopes
    if np.linalg.cond(information) > 1e20:
        return None
    scatter = max(2 * float(best.cost) / max(len(x) - 5, 1), 1.0)
    error = float(np.sqrt(np.linalg.inv(information)[4, 4] * scatter))
    return Quantity(float(best.x[4]), error) if error <= WORST_ERROR * best.x[4] else None
