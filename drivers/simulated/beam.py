"""From the mirrors' deflection to the spot on the wall: the true geometry of the simulated bench."""

from dataclasses import dataclass
from math import cos, hypot, radians, sin, tan

from pydantic import Field

from nlos.configs.settings import Settings
from nlos.drivers.galvo.mirror import MirrorAngles

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0


class Misalignment(Settings):
    """How the real bench differs from the drawing: what a calibration is there to find. Places and angles without a
    value are as the bench file's `geometry` draws them; with one, they stay true whatever is written there."""

    wall_distance_m: float | None = Field(default=None, gt=0)
    """From the second mirror to the wall, straight ahead."""
    scanner_x_m: float | None = None
    """How far the scanner is to the right of the wall's centre."""
    scanner_y_m: float | None = None
    """How far the scanner is above the wall's centre."""
    x_volts_per_degree: float | None = Field(default=None, ge=-10, le=10)
    """What the x axis behind a TriggerScope really takes, negative where it is mounted the other way round."""
    y_volts_per_degree: float | None = Field(default=None, ge=-10, le=10)
    """The same for the y axis."""
    axes_swapped: bool = False
    """Whether the cables to the head are exchanged: told to turn x, it turns y."""
    x_gain: float = Field(default=1.0, gt=0)
    """Real over nominal deflection of the x mirror."""
    y_gain: float = Field(default=1.0, gt=0)
    """Real over nominal deflection of the y mirror."""
    x_offset_deg: float = 0.0
    """Optical deflection at nominal zero."""
    y_offset_deg: float = 0.0
    """Optical deflection at nominal zero."""
    wall_pitch_deg: float | None = Field(default=None, gt=-60, lt=60)
    """The wall's top edge leans away from the scanner."""
    wall_yaw_deg: float | None = Field(default=None, gt=-60, lt=60)
    """The wall's right edge swings away from the scanner."""


@dataclass(frozen=True)
class Spot:
    """Where the beam meets the wall, how far it went from the first mirror, and at what cosine it arrives."""

    x_m: float
    y_m: float
    range_m: float
    cos_incidence: float


class BeamPath:
    """A two-mirror head in front of a plane wall.

    With the wall square to the undeflected beam this is x = (D / cos y + e) tan x, y = D tan y, range
    (D / cos y + e) / cos x, for the angles x, y, wall distance D and mirror separation e.
    """

    def __init__(
        self, wall_distance_m: float, mirror_separation_m: float = 0.0, misalignment: Misalignment | None = None
    ) -> None:
        self._separation_m = mirror_separation_m
        self._off = misalignment or Misalignment()
        self._distance_m = wall_distance_m if self._off.wall_distance_m is None else self._off.wall_distance_m
        self._place_m = (self._off.scanner_x_m or 0.0, self._off.scanner_y_m or 0.0)
        pitch, yaw = radians(self._off.wall_pitch_deg or 0.0), radians(self._off.wall_yaw_deg or 0.0)
        # Scanner coordinates have z from the wall to the scanner; the wall's edges lean towards -z.
        self._right = (cos(yaw), 0.0, -sin(yaw))
        self._up = (-sin(pitch) * sin(yaw), cos(pitch), -sin(pitch) * cos(yaw))
        self._normal = (cos(pitch) * sin(yaw), sin(pitch), cos(pitch) * cos(yaw))

    def spot(self, angles: MirrorAngles) -> Spot | None:
        """The spot on the wall's plane, or None where the beam does not meet it."""
        off = self._off
        x_rad, y_rad = (angles.y_rad, angles.x_rad) if off.axes_swapped else (angles.x_rad, angles.y_rad)
        x_rad = x_rad * off.x_gain + radians(off.x_offset_deg)
        y_rad = y_rad * off.y_gain + radians(off.y_offset_deg)
        if not (abs(x_rad) < 1.55 and abs(y_rad) < 1.55):
            return None
        start = (self._place_m[0] + self._separation_m * tan(x_rad), self._place_m[1], self._distance_m)
        ray = (sin(x_rad), cos(x_rad) * sin(y_rad), -cos(x_rad) * cos(y_rad))
        cosine = -_dot(ray, self._normal)
        if cosine < 1e-3:
            return None
        length_m = _dot(start, self._normal) / cosine
        point = (start[0] + length_m * ray[0], start[1] + length_m * ray[1], start[2] + length_m * ray[2])
        before_m = hypot(self._separation_m, self._separation_m * tan(x_rad))
        return Spot(_dot(point, self._right), _dot(point, self._up), before_m + length_m, cosine)


def _dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
