"""The offset map of a bench: when direct light arrives from every place on the wall."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S

Floats = npt.NDArray[np.float64]
SAME_PLACE_M = 1e-3
"""Nearer than this, two positions on the wall are one place."""


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
        """Arrival at wall positions: the residual of the nearest measured point within a millimetre, others follow the
        fit."""
        x, y = np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
        sx, sy, sz = self.scanner_position_m
        arrival = self.delay_s + 2 * np.sqrt((x - sx) ** 2 + (y - sy) ** 2 + sz**2) / SPEED_OF_LIGHT_M_PER_S
        known = np.isfinite(arrival)
        extra = np.zeros(arrival.shape)
        _, nearest = self._places.query(np.stack([x, y], axis=-1)[known], distance_upper_bound=SAME_PLACE_M)
        extra[known] = np.append(self.residual_s, 0.0)[nearest]  # N where none is near enough
        return np.asarray(arrival + extra)

    @cached_property
    def _places(self) -> "scipy.spatial.cKDTree":
        return scipy.spatial.cKDTree(np.column_stack([self.x_m, self.y_m]))
