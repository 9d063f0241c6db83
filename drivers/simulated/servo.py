"""A galvo head behind its servo boards: a delay, a limit to its speed and a finite bandwidth, for each of two axes.

The driver's table of settling times is not consulted: what plans a scan and what moves the beam share no numbers.
"""

import math
from dataclasses import dataclass

from pydantic import Field

from nlos.configs.settings import Settings
from nlos.drivers.galvo.mirror import MirrorAngles

_HALF_POWER = math.sqrt(math.sqrt(2.0) - 1.0)
"""Where a critically damped second-order response has lost 3 dB, in units of its natural frequency."""
_WHOLE_S = 1e-10
"""Times within a movement are rounded to this, so that a movement does not depend on when it is made."""


class ServoSettings(Settings):
    """What a data sheet says of a head; mechanical angles."""

    bandwidth_hz: float = Field(default=2500.0, ge=1, le=1e5)
    """Small-angle bandwidth at -3 dB."""
    slew_deg_per_s: float = Field(default=6000.0, gt=0)
    """Largest mechanical speed of an axis."""
    delay_us: float = Field(default=20.0, ge=0, le=1e4)
    """Between a command and the first movement."""
    rest_deg: float = Field(default=0.004, gt=0, le=0.1)
    """How near its target friction holds an axis still, mechanical."""


@dataclass(frozen=True)
class _Leg:
    """The way to one target, from `start_s` on: where the speed-limited command, the axis and its speed were then."""

    target_rad: float
    start_s: float
    command_rad: float
    place_rad: float
    speed_rad_per_s: float


class ServoAxis:
    """One axis. Its command runs to each target at the largest speed; the axis follows it critically damped."""

    def __init__(self, settings: ServoSettings) -> None:
        self._natural = 2 * math.pi * settings.bandwidth_hz / _HALF_POWER  # rad/s
        self._slew = 2 * math.radians(settings.slew_deg_per_s)  # optical angles turn twice as fast
        self._delay_s = settings.delay_us * 1e-6
        self._rest_rad = 2 * math.radians(settings.rest_deg)
        self._legs = [_Leg(0.0, -math.inf, 0.0, 0.0, 0.0)]

    def steer(self, target_rad: float, when_s: float) -> None:
        """A new target; the same one again changes nothing."""
        if target_rad == self._legs[-1].target_rad:
            return
        last = self._legs[-1]
        start_s = max(when_s + self._delay_s, last.start_s)
        begun = sum(leg.start_s <= when_s for leg in self._legs)
        self._legs = [*self._legs[max(begun - 1, 0) :], _Leg(target_rad, start_s, *self._state(last, start_s))]

    def at(self, when_s: float) -> float:
        """The optical angle at a time not before the last steering."""
        leg = next((leg for leg in reversed(self._legs) if leg.start_s <= when_s), self._legs[0])
        return self._state(leg, when_s)[1]

    def _state(self, leg: _Leg, when_s: float) -> tuple[float, float, float]:
        """(speed-limited command, angle, angular speed) on the way of a leg."""
        if leg.start_s == -math.inf:
            return leg.command_rad, leg.place_rad, leg.speed_rad_per_s
        left_s = max(round((when_s - leg.start_s) / _WHOLE_S), 0) * _WHOLE_S
        way_rad = leg.target_rad - leg.command_rad
        ramp_s = abs(way_rad) / self._slew
        slope = math.copysign(self._slew, way_rad)
        place, speed = self._follow(leg.command_rad, slope, leg.place_rad, leg.speed_rad_per_s, min(left_s, ramp_s))
        if left_s < ramp_s:
            return leg.command_rad + slope * left_s, place, speed
        place, speed = self._follow(leg.target_rad, 0.0, place, speed, left_s - ramp_s)
        if abs(place - leg.target_rad) + abs(speed) / self._natural < self._rest_rad:
            return leg.target_rad, leg.target_rad, 0.0
        return leg.target_rad, place, speed

    def _follow(self, command: float, slope: float, place: float, speed: float, for_s: float) -> tuple[float, float]:
        """Angle and speed after following, for a while, a command that changes evenly from `command` on: the solution
        of p'' = w^2 (r - p) + 2 w (0 - p'), which trails a ramp by 2 / w."""
        w = self._natural
        off = place - command + 2 * slope / w
        rate = speed - slope + w * off
        left = math.exp(-w * for_s)
        transient = (off + rate * for_s) * left
        return command + slope * (for_s - 2 / w) + transient, slope + rate * left - w * transient


class GalvoHead:
    """Two axes of a kind."""

    def __init__(self, settings: ServoSettings) -> None:
        self._x, self._y = ServoAxis(settings), ServoAxis(settings)

    def steer(self, target: MirrorAngles, when_s: float) -> None:
        """New targets for both axes at once."""
        self._x.steer(target.x_rad, when_s)
        self._y.steer(target.y_rad, when_s)

    def at(self, when_s: float) -> MirrorAngles:
        """Where the head points at a time not before the last steering."""
        return MirrorAngles(self._x.at(when_s), self._y.at(when_s))
