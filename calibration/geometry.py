"""Where the beam meets the wall: the two-mirror model, and the constants of a bench fitted to spots and direct times.

Scanner coordinates have their origin where the undeflected beam of a scanner at (0, 0) meets the wall, and z from
there to the scanner; wall coordinates are x right and y up in the wall's plane, with the same origin.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from calibration.errors import InvalidData

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
        pitch, yaw = self.wall_pitch_rad, self.wall_yaw_rad
        right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
        up = np.array([-np.sin(pitch) * np.sin(yaw), np.cos(pitch), -np.sin(pitch) * np.cos(yaw)])
        normal = np.cross(right, up)
        length = -np.tensordot(normal, start, 1) / np.tensordot(normal, ray, 1)
        point = start + length * ray
        return np.tensordot(right, point, 1), np.tensordot(up, point, 1), length + lever / np.cos(ax)

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


@dataclass(frozen=True)
class GeometryFit:
    """A fitted geometry; `errors` are one standard error for each name in `free` (metres, radians, seconds)."""

    geometry: ScannerGeometry
    delay_s: float
    """Arrival of a photon that travelled no distance; 0 where no times were given."""
    errors: dict[str, float]
    spot_residual_m: Floats  # (N, 2), measured less fitted; empty without spots
    height_m: Floats  # (N,), how far the wall stands out of the fitted plane towards the scanner; empty without times
    accepted: npt.NDArray[np.bool_]  # (N,)


FROM_TIMES = ("wall_distance_m", "wall_pitch_rad", "wall_yaw_rad", "delay_s")
FROM_SPOTS = ("x_gain", "y_gain", "x_offset_rad", "y_offset_rad", "scanner_x_m", "scanner_y_m")


def fit_geometry(
    start: ScannerGeometry,
    x_rad: npt.ArrayLike,
    y_rad: npt.ArrayLike,
    *,
    spots_m: npt.ArrayLike | None = None,
    spot_error_m: float = 1e-3,
    arrival_s: npt.ArrayLike | None = None,
    arrival_error_s: npt.ArrayLike = 10e-12,
    free: Sequence[str] | None = None,
) -> GeometryFit:
    """Fits `free` (fields of `ScannerGeometry`, and `delay_s`) to commanded angles (N,), and to measured spots (N, 2),
    direct arrivals (N,) or both. By default, times tell distance, tilt and delay, spots tell gains, offsets and the
    scanner's place.

    Robust: a soft loss, then without residuals beyond 4 times the scatter. Raises `InvalidData` with fewer than nine
    points, or where the data leave a parameter undetermined.
    """
    ax, ay = np.asarray(x_rad, dtype=np.float64), np.asarray(y_rad, dtype=np.float64)
    if len(ax) < 9:
        raise InvalidData(f"{len(ax)} points are given; the two-mirror model needs nine. Use a homography for four.")
    spots = None if spots_m is None else np.asarray(spots_m, dtype=np.float64)
    times = None if arrival_s is None else np.asarray(arrival_s, dtype=np.float64)
    time_error = np.broadcast_to(np.asarray(arrival_error_s, dtype=np.float64), ax.shape)
    names = list(free or (*(FROM_SPOTS if spots is not None else ()), *(FROM_TIMES if times is not None else ())))
    to_metres = SPEED_OF_LIGHT_M_PER_S / 2
    usable = np.ones(len(ax), bool)
    if times is not None:
        usable = np.isfinite(times) & np.isfinite(time_error)

    def unpack(p: Floats) -> tuple[ScannerGeometry, float]:
        values = dict(zip(names, p.tolist(), strict=True))
        delay_m = values.pop("delay_s", 0.0)
        return replace(start, **values), delay_m

    def residuals(p: Floats, keep: npt.NDArray[np.bool_]) -> Floats:
        geometry, delay_m = unpack(p)
        x, y, path = geometry.spots(ax[keep], ay[keep])
        parts = []
        if spots is not None:
            parts += [(spots[keep, 0] - x) / spot_error_m, (spots[keep, 1] - y) / spot_error_m]
        if times is not None:
            parts.append((times[keep] * to_metres - path - delay_m) / (time_error[keep] * to_metres))
        return np.concatenate(parts)

    first = np.array([0.0 if name == "delay_s" else getattr(start, name) for name in names])
    if times is not None and "delay_s" in names:
        path = start.spots(ax, ay)[2]
        first[names.index("delay_s")] = np.median((times * to_metres - path)[usable])
    solution = least_squares(residuals, first, loss="soft_l1", f_scale=2.0, args=(usable,)).x
    accepted = usable
    for _ in range(4):
        off = np.abs(residuals(solution, usable)).reshape(-1, int(usable.sum()))
        limit = 4 * np.maximum(1.4826 * np.median(off, axis=1, keepdims=True), 1e-6)
        kept = usable.copy()
        kept[usable] = (off <= limit).all(axis=0)
        if kept.sum() < 9 or (kept == accepted).all():
            break
        accepted = kept
        solution = least_squares(residuals, solution, args=(accepted,)).x
    final = least_squares(residuals, solution, args=(accepted,))
    jacobian = np.asarray(final.jac, dtype=np.float64)
    information = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(information))
    if (scale == 0).any() or np.linalg.cond(information / np.outer(scale, scale)) > 1e13:
        raise InvalidData(f"these points do not determine all of {', '.join(names)}: fix some, or spread the points.")
    freedom = max(len(final.fun) - len(names), 1)
    errors = np.sqrt(np.diag(np.linalg.inv(information)) * max(float((final.fun**2).sum()) / freedom, 0.0))
    geometry, delay_m = unpack(final.x)
    x, y, path = geometry.spots(ax, ay)
    units = [1 / to_metres if name == "delay_s" else 1.0 for name in names]
    return GeometryFit(
        geometry,
        delay_m / to_metres,
        {name: float(e * u) for name, e, u in zip(names, errors, units, strict=True)},
        np.empty((0, 2)) if spots is None else spots - np.column_stack([x, y]),
        np.empty(0) if times is None else (path + delay_m - times * to_metres) * _cosine(geometry, ax, ay),
        accepted,
    )


def _cosine(geometry: ScannerGeometry, x_rad: Floats, y_rad: Floats) -> Floats:
    """Cosine between beam and the wall's normal, from how far the spot moves when the wall does."""
    step = 1e-4
    moved = replace(geometry, wall_distance_m=geometry.wall_distance_m + step)
    along = (moved.spots(x_rad, y_rad)[2] - geometry.spots(x_rad, y_rad)[2]) / step
    return np.asarray(np.cos(geometry.wall_pitch_rad) * np.cos(geometry.wall_yaw_rad) / along)
