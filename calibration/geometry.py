"""Where the beam meets the wall: the two-mirror model, and the angles that aim at a point of the wall.

Scanner coordinates have their origin where the undeflected beam of a scanner at (0, 0) meets the wall, and z from
there to the scanner; wall coordinates are x right and y up in the wall's plane, with the same origin.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.calibration.errors import InvalidData

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ScannerGeometry:
    """A two-mirror head in front of a plane wall: commanded angles -> spot and distance travelled.

    Angles are optical. The beam meets the x mirror, `mirror_separation_m` later the y mirror.
    """

    wall_distance_m: float
    mirror_separation_m: float = 0.0
    scanner_x_m: float = 0.0
    scanner_y_m: float = 0.0
    x_gain: float = 1.0
    """True over commanded deflection."""
    y_gain: float = 1.0
    x_offset_rad: float = 0.0
    y_offset_rad: float = 0.0
    wall_pitch_rad: float = 0.0
    """The wall's top edge leans away from the scanner."""
    wall_yaw_rad: float = 0.0
    """The wall's right edge swings away from the scanner."""

    def spots(self, x_rad: npt.ArrayLike, y_rad: npt.ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Wall position x, y and the distance from the first mirror to it, in metres, in the shape of the angles."""
        ax = np.asarray(x_rad, dtype=np.float64) * self.x_gain + self.x_offset_rad
        ay = np.asarray(y_rad, dtype=np.float64) * self.y_gain + self.y_offset_rad
        lever = self.mirror_separation_m
        start = np.stack(
            [
                self.scanner_x_m + lever * np.tan(ax),
                np.full_like(ax, self.scanner_y_m),
                np.full_like(ax, self.wall_distance_m),
            ]
        )
        ray = np.stack([np.sin(ax), np.cos(ax) * np.sin(ay), -np.cos(ax) * np.cos(ay)])
        right, up, normal = self._wall
        length = -np.tensordot(normal, start, 1) / np.tensordot(normal, ray, 1)
        point = start + length * ray
        return np.tensordot(right, point, 1), np.tensordot(up, point, 1), length + lever / np.cos(ax)

    @property
    def scanner_m(self) -> Floats:
        """(3,): the scanner in wall coordinates, z > 0 on the side away from the scene."""
        return np.asarray(self._wall @ np.array([self.scanner_x_m, self.scanner_y_m, self.wall_distance_m]))

    @property
    def _wall(self) -> Floats:
        """(3, 3): its right, its up, its normal towards the scanner."""
        pitch, yaw = self.wall_pitch_rad, self.wall_yaw_rad
        right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
        up = np.array([-np.sin(pitch) * np.sin(yaw), np.cos(pitch), -np.sin(pitch) * np.cos(yaw)])
        return np.stack([right, up, np.cross(right, up)])

    def ranges_m(self, x_rad: npt.ArrayLike, y_rad: npt.ArrayLike) -> Floats:
        """From the first mirror to the wall along the beam."""
        return self.spots(x_rad, y_rad)[2]

    def wall_points(self, x_rad: npt.ArrayLike, y_rad: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Where on the wall (x_m, y_m) the beam of commanded angles lands."""
        x_m, y_m, _ = self.spots(x_rad, y_rad)
        return x_m, y_m

    def angles_rad(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> tuple[Floats, Floats]:
        """The commanded angles that put the beam on wall positions: what the next scan is to be aimed by. By Newton's
        method, to 1e-9 m. Raises `InvalidData` for positions that the beam cannot reach."""
        x, y = np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
        ax = np.arctan((x - self.scanner_x_m) / self.wall_distance_m)
        ay = np.arctan((y - self.scanner_y_m) / self.wall_distance_m)
        step = 1e-6
        for _ in range(30):
            sx, sy, _ = self.spots(ax, ay)
            off_x, off_y = x - sx, y - sy
            if np.hypot(off_x, off_y).max(initial=0.0) < 1e-9:
                return ax, ay
            bx, by, _ = self.spots(ax + step, ay)
            cx, cy, _ = self.spots(ax, ay + step)
            j = np.array([[bx - sx, cx - sx], [by - sy, cy - sy]]) / step
            det = j[0, 0] * j[1, 1] - j[0, 1] * j[1, 0]
            ax = np.clip(ax + (j[1, 1] * off_x - j[0, 1] * off_y) / det, -1.4, 1.4)
            ay = np.clip(ay + (j[0, 0] * off_y - j[1, 0] * off_x) / det, -1.4, 1.4)
        far = int(np.argmax(np.hypot(off_x, off_y)))
        raise InvalidData(
            f"wall point {far} at ({x.flat[far]:+.3f} m, {y.flat[far]:+.3f} m) cannot be reached by the beam. Shrink "
            "the wall or move the scanner back."
        )
