"""From a point on the wall to mirror angles and back, for a two-mirror head somewhere in front of a flat wall."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from nlos.drivers.galvo.mirror import MirrorAngles

Floats = npt.NDArray[np.float64]


class Aiming(Protocol):
    """Whatever knows where mirror angles put the beam: the drawn geometry below, or a measured one."""

    def angles_rad(self, x_m: Floats, y_m: Floats) -> tuple[Floats, Floats]:
        """Optical angles (x_rad, y_rad) for wall points, arrays of one shape."""
        ...

    def ranges_m(self, x_rad: Floats, y_rad: Floats) -> Floats:
        """From the first mirror to the wall along the beam."""
        ...

    def wall_points(self, x_rad: Floats, y_rad: Floats) -> tuple[Floats, Floats]:
        """Where on the wall (x_m, y_m) the beam lands: the inverse of `angles_rad`."""
        ...


@dataclass(frozen=True)
class Aim:
    """As a bench file draws it: `calibration.geometry.ScannerGeometry` without gains and offsets, in closed form.

    The undeflected beam of a scanner at (0, 0) meets the wall's centre; x right, y up, z from there to the scanner. The
    beam meets the x mirror first, `mirror_separation_m` later the y mirror. With P the wall point in these coordinates,
    tan(theta_y) = (P_y - y0) / (D - P_z) and tan(theta_x) = (P_x - x0) / ((D - P_z) / cos(theta_y) + e), optical angles
    (the pincushion of two-mirror heads).
    """

    wall_distance_m: float
    mirror_separation_m: float = 0.0
    scanner_x_m: float = 0.0
    scanner_y_m: float = 0.0
    wall_pitch_rad: float = 0.0
    """The wall's top edge leans away from the scanner."""
    wall_yaw_rad: float = 0.0
    """The wall's right edge swings away from the scanner."""

    def __post_init__(self) -> None:
        if not self.wall_distance_m > 0:
            raise ValueError(f"wall distance is {self.wall_distance_m:g} m; it must be above 0")
        if not self.mirror_separation_m >= 0:
            raise ValueError(f"mirror separation is {self.mirror_separation_m:g} m; it must not be below 0")

    def angles(self, x_m: float, y_m: float) -> MirrorAngles:
        """The optical angles that put the beam on wall point (x_m, y_m)."""
        x_rad, y_rad = self.angles_rad(np.float64(x_m), np.float64(y_m))
        return MirrorAngles(float(x_rad), float(y_rad))

    def angles_rad(self, x_m: Floats | np.float64, y_m: Floats | np.float64) -> tuple[Floats, Floats]:
        """`angles` for arrays of any one shape: (x_rad, y_rad)."""
        right, up, _ = self._wall
        x, y, z = (right[k] * np.asarray(x_m) + up[k] * np.asarray(y_m) for k in range(3))
        depth = self.wall_distance_m - z
        y_rad = np.arctan((y - self.scanner_y_m) / depth)
        lever_m = depth / np.cos(y_rad) + self.mirror_separation_m
        return np.arctan((x - self.scanner_x_m) / lever_m), y_rad

    def wall_point(self, angles: MirrorAngles) -> tuple[float, float]:
        """Where on the wall (x_m, y_m) the beam lands: the inverse of `angles`."""
        x_m, y_m = self.wall_points(np.float64(angles.x_rad), np.float64(angles.y_rad))
        return float(x_m), float(y_m)

    def wall_points(self, x_rad: Floats | np.float64, y_rad: Floats | np.float64) -> tuple[Floats, Floats]:
        """`wall_point` for arrays of any one shape: (x_m, y_m)."""
        right, up, _ = self._wall
        start, ray, length_m = self._beam(np.asarray(x_rad), np.asarray(y_rad))
        point = start + length_m * ray
        return np.tensordot(right, point, 1), np.tensordot(up, point, 1)

    def ranges_m(self, x_rad: Floats | np.float64, y_rad: Floats | np.float64) -> Floats:
        """From the first mirror to the wall along the beam, in the shape of the angles."""
        _, _, length_m = self._beam(np.asarray(x_rad), np.asarray(y_rad))
        return np.asarray(length_m + self.mirror_separation_m / np.cos(x_rad))

    @property
    def _wall(self) -> tuple[Floats, Floats, Floats]:
        """Its right, its up, its normal towards the scanner."""
        pitch, yaw = self.wall_pitch_rad, self.wall_yaw_rad
        right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
        up = np.array([-np.sin(pitch) * np.sin(yaw), np.cos(pitch), -np.sin(pitch) * np.cos(yaw)])
        return right, up, np.cross(right, up)

    def _beam(self, x_rad: Floats, y_rad: Floats) -> tuple[Floats, Floats, Floats]:
        """Where it leaves the second mirror, its direction, and how far it goes to the wall."""
        side_m = self.mirror_separation_m * np.tan(x_rad)
        start = np.stack(
            [
                self.scanner_x_m + side_m,
                np.full_like(side_m, self.scanner_y_m),
                np.full_like(side_m, self.wall_distance_m),
            ]
        )
        ray = np.stack([np.sin(x_rad), np.cos(x_rad) * np.sin(y_rad), -np.cos(x_rad) * np.cos(y_rad)])
        normal = self._wall[2]
        return start, ray, -np.tensordot(normal, start, 1) / np.tensordot(normal, ray, 1)
