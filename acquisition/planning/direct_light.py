"""When direct light should come at each point of a plan, and whether the plan's time window holds it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.aim import Aiming
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.drivers.bench_settings import BenchSettings

BEFORE_S, AFTER_S = 0.2e-9, 0.3e-9
"""What belongs to a direct pulse of 100 ps before and after its maximum."""
_ROUNDING = 1.0 + 1e-6
_TURNED = {
    "x is reversed": (0, -1, 1),
    "y is reversed": (0, 1, -1),
    "x and y are reversed": (0, -1, -1),
    "x and y are swapped": (1, 1, 1),
    "x and y are swapped and x is reversed": (1, -1, 1),
    "x and y are swapped and y is reversed": (1, 1, -1),
    "x and y are swapped and reversed": (1, -1, -1),
}
"""How a beam may go that is not sent so: whether the axes are swapped, then each one's sign."""
_TELLS_S = 15e-12
_LOOKED_AT = 1_000


@dataclass(frozen=True)
class DirectLight:
    """`arrival_s` (N,): for each point of a plan the time after the sync pulse, less than a period. `delay_known`: from
    the bench file's `first_light`; without it cables are taken to have no length."""

    arrival_s: npt.NDArray[np.float64]
    period_s: float
    delay_known: bool
    direct_cps: float | None = None
    turned_s: Mapping[str, npt.NDArray[np.float64]] = field(default_factory=dict)
    """What is wrong with the axes -> `arrival_s` then, where that tells: the wall leans."""

    def seen_at_s(self, plan: ScanPlan) -> npt.NDArray[np.float64]:
        """(N,): when the window meets it, of this pulse or of an earlier one; a window that begins after it meets the
        next period's."""
        start_s = plan.axis.offset_s
        late = np.ceil((start_s - (self.arrival_s - BEFORE_S)) / self.period_s)
        return np.asarray(self.arrival_s + np.maximum(late, 0) * self.period_s)

    def inside(self, plan: ScanPlan) -> npt.NDArray[np.bool_]:
        """(N,): whether all of the pulse falls into the window."""
        end_s = plan.axis.offset_s + plan.axis.bins * plan.axis.bin_width_s
        return np.asarray(self.seen_at_s(plan) + AFTER_S <= end_s)


def expected_direct(plan: ScanPlan, settings: BenchSettings, aim: Aiming) -> DirectLight:
    """By the geometry that aims, and the delay that first light found."""
    x_rad, y_rad = aim.angles_rad(plan.positions.x_m, plan.positions.y_m)
    found, period_s = settings.first_light, 1 / settings.laser.repetition_hz
    delay_s = 0.0 if found is None else found.delay_ns * 1e-9
    arrival_s = (2 * aim.ranges_m(x_rad, y_rad) / SPEED_OF_LIGHT_M_PER_S + delay_s) % period_s
    direct_cps = None if found is None else found.direct_cps
    return DirectLight(
        arrival_s, period_s, found is not None, direct_cps, _turned(aim, x_rad, y_rad, delay_s, period_s)
    )


def _turned(
    aim: Aiming, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64], delay_s: float, period_s: float
) -> dict[str, npt.NDArray[np.float64]]:
    """Only those whose times differ from the drawn ones by more than an offset, told by some of the points."""
    some, turned = slice(None, None, max(1, len(x_rad) // _LOOKED_AT)), {}
    drawn_m = aim.ranges_m(x_rad[some], y_rad[some])
    for how, (swapped, x_sign, y_sign) in _TURNED.items():
        goes_x_rad, goes_y_rad = x_sign * (y_rad if swapped else x_rad), y_sign * (x_rad if swapped else y_rad)
        apart_m = aim.ranges_m(goes_x_rad[some], goes_y_rad[some]) - drawn_m
        if 2 * np.ptp(apart_m) / SPEED_OF_LIGHT_M_PER_S > _TELLS_S:
            range_m = aim.ranges_m(goes_x_rad, goes_y_rad)
            turned[how] = (2 * range_m / SPEED_OF_LIGHT_M_PER_S + delay_s) % period_s
    return turned


def window_warnings(plan: ScanPlan, direct: DirectLight) -> list[str]:
    """What is wrong with the plan's time window, in words; empty where nothing is."""
    axis, warnings = plan.axis, []
    length_s = axis.bins * axis.bin_width_s
    window = f"the window, {axis.offset_s * 1e9:g} to {(axis.offset_s + length_s) * 1e9:g} ns"
    if length_s > direct.period_s * _ROUNDING:
        most = int(direct.period_s / axis.bin_width_s * _ROUNDING)
        warnings.append(
            f"{window}, is longer than the laser's period of {direct.period_s * 1e9:g} ns: what comes after that is "
            f"the next pulse's light, or no light at all. Take at most {most} bins."
        )
    inside = direct.inside(plan)
    if inside.all():
        return warnings
    known = "" if direct.delay_known else ", if cables delay nothing"
    first_ns, last_ns = direct.arrival_s.min() * 1e9, direct.arrival_s.max() * 1e9
    remedy = f"Begin histogram.offset_ns at {max(0.0, np.floor(first_ns - 1.0)):g} or earlier"
    if not direct.delay_known:  # what a window is set by
        remedy = f"First `nlos calibrate --first-light`, which measures that; without any delay: b{remedy[1:]}"
    said = f"it comes {first_ns:.2f} to {last_ns:.2f} ns after the sync pulse{known}"
    if inside.any():
        cut = int((~inside).sum())
        warnings.append(f"{window}, cuts off direct light at {cut} of {len(plan)} points: {said}. {remedy}.")
    else:
        warnings.append(f"{window}, misses direct light: {said}. {remedy}.")
    return warnings
