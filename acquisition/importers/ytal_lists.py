"""y-tal's lists of points (T_Si): histograms at sensor points anywhere on a wall z = const, each with a laser point of
its own or all with one. Format: y-tal 0.20, `tal.io`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import NO_WALL, FreePoints, ImportedScan
from nlos.acquisition.importers.moveout import moved_out
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, as_floats
from nlos.acquisition.wall import about_their_middle, grid_around

Array = npt.NDArray[np.float64]
_FLAT_M = 1e-3


@dataclass(frozen=True)
class ListedPoints:
    """What such a capture holds. `origins`: where laser and sensor stand, if the ways to them are within the times."""

    counts: npt.NDArray[np.generic]  # (T, N)
    lasers: Array  # (N, 3) or (1, 3)
    sensors: Array  # (N, 3)
    origins: tuple[Array, Array] | None
    delta_m: float
    start_m: float
    hints: tuple[Array, ...]
    """From the wall to the hidden scene, as `on_wall` takes them."""


def at_free_positions(path: Path, held: ListedPoints, ours: Mapping[str, object]) -> ImportedScan:
    """The scan, x to the right as seen from the scanner; with what `nlos export` said of it (`ours`), else {}. Where
    laser and sensor points differ, by normal moveout. Raises `InvalidData`, naming the file, for points that are not as
    many as the histograms, not finite, or not in one plane."""
    sensors, count = held.sensors, held.counts.shape[1]
    if sensors.shape != (count, 3) or held.lasers.shape not in ((1, 3), sensors.shape):
        raise InvalidData(
            f"{path}: {count} histograms, {held.lasers.shape} laser and {sensors.shape} sensor points do not belong "
            "together: one laser point, or one for each sensor point, is expected"
        )
    lasers = np.broadcast_to(held.lasers, sensors.shape)
    if not (np.isfinite(lasers).all() and np.isfinite(sensors).all()):
        raise InvalidData(f"{path}: its laser or sensor points are not finite")
    if np.ptp(np.r_[lasers[:, 2], sensors[:, 2]]) > _FLAT_M:
        raise InvalidData(
            f"{path}: its points are not in one plane z = const. Write histograms [N, T] with laser_m and sensor_m "
            "[N, 3] to an NPZ, z from the wall to the hidden scene."
        )
    apart_m, middle = np.linalg.norm(lasers - sensors, axis=1), (lasers + sensors) / 2
    confocal = bool(apart_m.max() < 1e-4)
    late_m = held.start_m if confocal and held.origins is None and held.start_m > 0 else 0.0
    counts, raw = held.counts.T, confocal and ours.get("rectified") is False
    if not raw:
        first_m = np.full(count, held.start_m - late_m)
        for points, origin in zip((lasers, sensors), held.origins or (), strict=False):
            first_m -= np.linalg.norm(points - origin, axis=1)
        if not np.isfinite(first_m).all():
            raise InvalidData(f"{path}: laser_xyz or sensor_xyz is not finite, and times count from there")
        apart_m = np.where(apart_m < 1e-4, 0.0, apart_m)
        counts = np.stack(
            [moved_out(*each, held.delta_m) for each in zip(counts, apart_m.tolist(), first_m.tolist(), strict=True)]
        )
    notes = []
    facing = next((float(np.sign(hint[2])) for hint in held.hints if abs(hint[2]) > _FLAT_M), 1.0)
    if facing < 0:
        notes.append("the wall faces -z: y is up, right is -x")
    if not confocal:
        notes.append(
            f"laser and sensor points are up to {apart_m.max():.3g} m apart: taken for a confocal scan of midpoints by "
            "normal moveout, which assumes surfaces opposite these; others come out too near"
        )
    x_m, y_m, sides_m = facing * middle[:, 0], middle[:, 1].copy(), _pair(ours.get("wall_size_m"))
    if sides_m is None:
        x_m, y_m, moved = about_their_middle(x_m, y_m)
        notes += [moved] if moved else []
    wall = grid_around(x_m, y_m, sides_m)
    if sides_m is None:
        notes.append(f"{NO_WALL}; by its points it is {wall.width_m:.4g} x {wall.height_m:.4g} m")
    exposure_s = _exposures(ours.get("exposure_us"), count)
    if exposure_s is None:
        notes.append("exposure is not stored; assuming 1 s per point")
    time = TimeAxis(counts.shape[1], held.delta_m / SPEED_OF_LIGHT_M_PER_S, late_m / SPEED_OF_LIGHT_M_PER_S)
    return ImportedScan(
        FreePoints(as_floats(counts), np.ones(count) if exposure_s is None else exposure_s, x_m, y_m, wall, time),
        "y-tal HDF5",
        falloff=4,
        rectified=not raw,
        notes=(*notes, "scene description and normals are not imported"),
    )


def _pair(told: object) -> tuple[float, float] | None:
    """Width and height as exported; None where nobody says them."""
    if isinstance(told, list) and len(told) == 2 and all(isinstance(each, float) and each > 0 for each in told):
        return told[0], told[1]
    return None


def _exposures(told: object, count: int) -> Array | None:
    """Seconds per point as exported; None where nobody says so, or of other points."""
    try:
        exposure_us = np.asarray(told, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return exposure_us * 1e-6 if exposure_us.shape == (count,) else None
