"""How long a mirror needs until the beam is still: a calibrated table of step sizes."""

import math
from typing import Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from nlos.configs.settings import Settings
from nlos.drivers.galvo.mirror import MirrorAngles


class SettlePoint(Settings):
    """One measured line of the table: a step of one axis, in mechanical degrees, and the time it takes to settle."""

    step_deg: float = Field(gt=0)
    """Step of one axis, mechanical."""
    settle_ms: float = Field(gt=0)
    """Until the beam is still."""


class SettleModel(Settings):
    """Settled: within `within_deg`. Log-log interpolation between measured steps, straight on beyond the last.

    The default bounds a 10 mm galvo head from above: its specified small-angle step response, and half a period of the
    highest sine it follows at 20 and 40 degrees (Thorlabs GVS012 specification). Measure the head and replace it.
    """

    within_deg: float = Field(default=0.01, gt=0, le=1)
    """How near the target the axis is by then, in mechanical degrees."""
    table: tuple[SettlePoint, ...] = (
        SettlePoint(step_deg=0.4, settle_ms=0.40),
        SettlePoint(step_deg=20.0, settle_ms=7.7),
        SettlePoint(step_deg=40.0, settle_ms=20.0),
    )
    """Measured steps and settling times."""

    @model_validator(mode="after")
    def _rises(self) -> Self:
        steps = [point.step_deg for point in self.table]
        times = [point.settle_ms for point in self.table]
        if len(steps) < 2 or steps != sorted(set(steps)) or times != sorted(times):
            raise ValueError("table needs two or more steps, each larger than the one before and none faster")
        return self

    def axis_settle_s(self, step_rad: float) -> float:
        """Settling time of one axis after an optical step; 0 for no step."""
        step_deg = math.degrees(abs(step_rad)) / 2.0
        if step_deg == 0.0:
            return 0.0
        if step_deg <= self.table[0].step_deg:
            return self.table[0].settle_ms * 1e-3
        upper = next((i for i, point in enumerate(self.table) if step_deg <= point.step_deg), len(self.table) - 1)
        low = self.table[upper - 1]
        return low.settle_ms * 1e-3 * math.pow(step_deg / low.step_deg, self._slope(upper))

    def _slope(self, upper: int) -> float:
        """Of the line in log-log from the entry before `upper` to it."""
        low, high = self.table[upper - 1], self.table[upper]
        return math.log(high.settle_ms / low.settle_ms) / math.log(high.step_deg / low.step_deg)

    def axis_settles_s(self, steps_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """`axis_settle_s` of many steps, (N,), to the last digit."""
        table_deg = np.array([point.step_deg for point in self.table])
        low_s = np.array([point.settle_ms * 1e-3 for point in self.table])
        slopes = np.array([0.0, *(self._slope(upper) for upper in range(1, len(self.table)))])
        step_deg = np.degrees(np.abs(steps_rad)) / 2.0
        upper = np.clip(np.searchsorted(table_deg, step_deg), 1, len(self.table) - 1)
        # NumPy's own power may end on another last digit, from one processor to the next.
        powers = map(math.pow, (step_deg / table_deg[upper - 1]).tolist(), slopes[upper].tolist())
        found_s = low_s[upper - 1] * np.fromiter(powers, np.float64, len(step_deg))
        found_s[step_deg <= table_deg[0]] = low_s[0]
        found_s[step_deg == 0.0] = 0.0
        return found_s

    def settle_s(self, start: MirrorAngles, end: MirrorAngles) -> float:
        """Settling time of a move: both axes turn at once, the slower one decides."""
        return max(self.axis_settle_s(end.x_rad - start.x_rad), self.axis_settle_s(end.y_rad - start.y_rad))

    def settles_s(self, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """`settle_s` of the moves from each of these, (N,), to the next, (N - 1,)."""
        return np.maximum(self.axis_settles_s(np.diff(x_rad)), self.axis_settles_s(np.diff(y_rad)))
