"""Thousands of direct arrivals as a few hundred that say the same: neighbours averaged, strays left aside."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.geometry_fit import METRES_PER_S, DirectTimes, fit_geometry

Floats = npt.NDArray[np.float64]
CELLS = 12
"""Along each axis of the angles."""


def reduced_times(times: DirectTimes, start: ScannerGeometry) -> DirectTimes:
    """One arrival for each of 12 x 12 cells of angles, with its error; the same where there are fewer already.

    Averaged is what they differ by from the plane wall that fits them, so that a cell's middle and its mean arrival
    belong together. Raises `InvalidData` as `fit_geometry` does.
    """
    if len(times.x_rad) <= CELLS * CELLS:
        return times
    fit = fit_geometry(start, times)
    keep = fit.accepted

    def predicted_s(x_rad: Floats, y_rad: Floats) -> Floats:
        return np.asarray(fit.geometry.ranges_m(x_rad, y_rad) / METRES_PER_S + fit.delay_s)

    x, y, weight = times.x_rad[keep], times.y_rad[keep], (times.error_s[keep] * fit.scatter[1]) ** -2
    late_s = times.arrival_s[keep] - predicted_s(x, y)
    cell = _cells(x) * CELLS + _cells(y)
    cell = np.unique(cell, return_inverse=True)[1]
    total = np.bincount(cell, weight)
    x, y, late_s = (np.asarray(np.bincount(cell, each * weight) / total, np.float64) for each in (x, y, late_s))
    error_s = np.asarray(1 / np.sqrt(total), np.float64)
    return replace(times, x_rad=x, y_rad=y, arrival_s=predicted_s(x, y) + late_s, error_s=error_s)


def _cells(angles: Floats) -> npt.NDArray[np.int64]:
    part = (angles - angles.min()) / max(float(np.ptp(angles)), 1e-9)
    return np.asarray(np.minimum(part * CELLS, CELLS - 1), np.int64)
