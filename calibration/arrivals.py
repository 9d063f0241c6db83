"""The offset map of a bench: when direct light arrives from every place on the wall."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S

Floats = npt.NDArray[np.float64]
SAME_PLACE_M = 1e-3


@dataclass(frozen=True)
class Arrivals:
    """When direct light arrives after the sync pulse: the wall's fit, and how far measured points are off it."""

    scanner_position_m: Floats  # (3,), wall coordinates
    delay_s: float
    covariance: Floats  # (4, 4) of position in m and delay in s
    rms_s: float
    x_m: Floats  # (N,)
    y_m: Floats  # (N,)
    residual_s: Floats  # (N,): best estimate of the arrival less the fit's

    def at(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> Floats:
        """Arrival at wall positions: measured points within a millimetre keep their residual, others follow the fit."""
        x, y = np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
        sx, sy, sz = self.scanner_position_m
        arrival = self.delay_s + 2 * np.sqrt((x - sx) ** 2 + (y - sy) ** 2 + sz**2) / SPEED_OF_LIGHT_M_PER_S
        rows = np.array([self._rows.get(place, -1) for place in _places(x.ravel(), y.ravel())], dtype=np.int64)
        extra = np.where(rows >= 0, np.append(self.residual_s, 0.0)[rows], 0.0)
        return np.asarray(arrival + extra.reshape(x.shape))

    @cached_property
    def _rows(self) -> dict[tuple[int, int], int]:
        return {place: row for row, place in enumerate(_places(self.x_m, self.y_m))}


def _places(x: Floats, y: Floats) -> list[tuple[int, int]]:
    """Positions to a millimetre, as keys."""
    columns = (np.rint(np.asarray(axis) / SAME_PLACE_M).astype(np.int64).tolist() for axis in (x, y))
    return list(zip(*columns, strict=True))
