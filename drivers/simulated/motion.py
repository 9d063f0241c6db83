"""Where a hidden object is at every moment: its path, turns included, and when it is there at all."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np
import numpy.typing as npt
from pydantic import Field

from nlos.configs.settings import Settings

Vector = tuple[float, float, float]
Array = npt.NDArray[np.float64]


class Waypoint(Settings):
    """Where an object is at one moment; between two it moves and turns evenly. What is not said stays as it was."""

    at_s: float = Field(gt=0)
    """Seconds since the first point of the bench was lit; the object's own place is that of 0 s."""
    centre_m: Vector | None = None
    """Its centre: x, y, and z from the wall."""
    pitch_deg: float | None = None
    """Its top edge tips away from the wall."""
    yaw_deg: float | None = None
    """Its right edge swings away from the wall."""
    roll_deg: float | None = None
    """It turns in its own plane, its right edge upwards."""


@dataclass(frozen=True)
class Pose:
    """Place and turn of an object at one moment."""

    centre_m: Vector
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0

    @property
    def rotation(self) -> Array:
        """(3, 3): turns an object that faces the wall upright; its columns are where right, up and away point then."""
        pitch, yaw, roll = radians(self.pitch_deg), radians(self.yaw_deg), radians(self.roll_deg)
        right = np.array([cos(yaw), 0.0, sin(yaw)])
        up = np.array([-sin(pitch) * sin(yaw), cos(pitch), sin(pitch) * cos(yaw)])
        away = np.array([-cos(pitch) * sin(yaw), -sin(pitch), cos(pitch) * cos(yaw)])
        return np.stack([cos(roll) * right + sin(roll) * up, cos(roll) * up - sin(roll) * right, away], axis=1)


def poses(start: Pose, path: Sequence[Waypoint]) -> list[Pose]:
    """The pose at 0 s and at every waypoint."""
    found = [start]
    for point in path:
        said = {key: value for key, value in point.model_dump(exclude={"at_s"}).items() if value is not None}
        found.append(Pose(**{**vars(found[-1]), **said}))
    return found


def pose_at(time_s: float, start: Pose, path: Sequence[Waypoint]) -> Pose:
    """The pose at one moment; after the last waypoint the object rests there."""
    times_s = [0.0, *(point.at_s for point in path)]
    values = np.array([(*each.centre_m, each.pitch_deg, each.yaw_deg, each.roll_deg) for each in poses(start, path)])
    x, y, z, pitch, yaw, roll = (float(np.interp(time_s, times_s, column)) for column in values.T)
    return Pose((x, y, z), pitch, yaw, roll)
