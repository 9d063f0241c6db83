"""From a point on the wall to mirror angles and back, for a two-mirror head in front of a flat wall."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from nlos.drivers.galvo.mirror import MirrorAngles


class Aiming(Protocol):
    """Whatever knows where mirror angles put the beam: the ideal geometry below, or a measured one."""

    def angles_rad(
        self, x_m: npt.NDArray[np.float64], y_m: npt.NDArray[np.float64]
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Optical angles (x_rad, y_rad) for wall points, arrays of one shape."""
        ...


@dataclass(frozen=True)
class Aim:
    """Wall at `wall_distance_m`, perpendicular to the undeflected beam; mirrors `mirror_separation_m` apart.

    The beam meets the x mirror first, then the y mirror: x = (D / cos(theta_y) + e) tan(theta_x), y = D tan(theta_y),
    with optical angles (the pincushion of two-mirror heads).
    """

    wall_distance_m: float
    mirror_separation_m: float = 0.0

    def __post_init__(self) -> None:
        if not self.wall_distance_m > 0:
            raise ValueError(f"wall distance is {self.wall_distance_m:g} m; it must be above 0")
        if not self.mirror_separation_m >= 0:
            raise ValueError(f"mirror separation is {self.mirror_separation_m:g} m; it must not be below 0")

    def angles(self, x_m: float, y_m: float) -> MirrorAngles:
        """The optical angles that put the beam on wall point (x_m, y_m)."""
        x_rad, y_rad = self.angles_rad(np.float64(x_m), np.float64(y_m))
        return MirrorAngles(float(x_rad), float(y_rad))

    def angles_rad(
        self, x_m: npt.NDArray[np.float64] | np.float64, y_m: npt.NDArray[np.float64] | np.float64
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """`angles` for arrays of any one shape: (x_rad, y_rad)."""
        y_rad = np.arctan(np.asarray(y_m) / self.wall_distance_m)
        lever_m = self.wall_distance_m / np.cos(y_rad) + self.mirror_separation_m
        return np.arctan(np.asarray(x_m) / lever_m), y_rad

    def wall_point(self, angles: MirrorAngles) -> tuple[float, float]:
        """Where on the wall (x_m, y_m) the beam lands: the inverse of `angles`."""
        lever_m = self.wall_distance_m / np.cos(angles.y_rad) + self.mirror_separation_m
        return float(lever_m * np.tan(angles.x_rad)), float(self.wall_distance_m * np.tan(angles.y_rad))
