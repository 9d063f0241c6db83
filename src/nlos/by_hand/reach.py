"""Where the beam may be sent by hand: mirror limits, and the part of the wall that the bench file allows."""

import math

import numpy as np

from nlos.acquisition.planning.aim import Aiming
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import GalvoMirror, MirrorAngles


class Reach:
    """Angles and places of one bench, checked before anything is sent."""

    def __init__(self, settings: BenchSettings, mirror: GalvoMirror, aim: Aiming) -> None:
        self._allowed, self._mirror, self._aim = settings.geometry.allowed, mirror, aim

    def angles_of(self, x_m: float, y_m: float) -> MirrorAngles:
        """The angles that put the beam there. Raises `LimitError` outside the allowed area and the mirror's reach."""
        if not (math.isfinite(x_m) and math.isfinite(y_m)):
            raise LimitError("wall", f"({x_m:g}, {y_m:g}) m is not a place.", "Give x and y in metres.")
        if self._allowed is not None:
            self._allowed.check(x_m, y_m)
        x_rad, y_rad = self._aim.angles_rad(np.array([x_m]), np.array([y_m]))
        angles = MirrorAngles(float(x_rad[0]), float(y_rad[0]))
        self._mirror.check(angles)
        return angles

    def place_of(self, angles: MirrorAngles) -> tuple[float, float]:
        """Where on the wall (x_m, y_m) the beam is, by the bench's geometry."""
        x_m, y_m = self._aim.wall_points(np.array([angles.x_rad]), np.array([angles.y_rad]))
        return float(x_m[0]), float(y_m[0])

    def check(self, angles: MirrorAngles) -> None:
        """Raises `LimitError` for angles at which the beam may not be."""
        self._mirror.check(angles)
        if self._allowed is not None:
            self._allowed.check(*self.place_of(angles))
