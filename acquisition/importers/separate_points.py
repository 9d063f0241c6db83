"""Histograms whose laser and sensor points are stored as lists, `laser_m` and `sensor_m`: pairs anywhere, on walls that
need not be flat. They are taken for a confocal scan of their midpoints on a plane, by normal moveout (`moveout`).

A point z off that plane, towards the scene, is moved onto it by as much path: a static correction, as seismic imaging
has it for hills (Yilmaz, "Seismic Data Analysis", 2001, ch. 3.4). It is right for surfaces opposite the point.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.moveout import moved_out
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis

Array = npt.NDArray[Any]
POINTS = ("laser_m", "sensor_m")
_PLACES = re.compile(
    r"(laser|sensor|camera|detector|detect|spad)_?(?:grid)?_?(?:xyz|x_m|y_m|pos(?:itions?)?|points?)", re.IGNORECASE
)
_ONE_SENSOR = re.compile(r"spad_?index", re.IGNORECASE)
"""Of scans with one place of the sensor (Liu et al., Nature 2019)."""
_HILLY = 0.25
"""Of the points' extent: a wall rougher than that is no wall, or its z is another axis."""
_FLAT_M = 1e-3


@dataclass(frozen=True)
class PlacedLight:
    """What a confocal scan of points anywhere on a flat wall would see, and what is to be said of it."""

    counts: npt.NDArray[np.float32]  # (N, T)
    x_m: npt.NDArray[np.float64]  # (N,)
    y_m: npt.NDArray[np.float64]  # (N,)
    time: TimeAxis
    notes: tuple[str, ...]


def refuse_other_names(name: str, names: Iterable[str]) -> None:
    """Raises `InvalidData` for a file with places of laser and sensor each, in names that have no meaning here: it
    would be taken for confocal."""
    names = sorted(names)
    places = [each for each in names if _PLACES.fullmatch(each)]
    if one := [each for each in names if _ONE_SENSOR.fullmatch(each)]:
        raise InvalidData(
            f"{name}: holds {one[0]}: a scan by the laser alone, its sensor at one place, is not confocal. Store where "
            "laser and sensor were as laser_m and sensor_m [N, 3] beside histograms [N, T]."
        )
    if len({found[1].lower() for each in places if (found := _PLACES.fullmatch(each))}) > 1:
        raise InvalidData(
            f"{name}: holds {', '.join(places)}: places of laser and sensor of their own are read from y-tal's HDF5 "
            "(HDF5_TAL: T_Sx_Sy, T_Lx_Ly_Sx_Sy), and as laser_m and sensor_m [N, 3] beside histograms [N, T]. Write "
            "them as that; a confocal scan needs x_m and y_m alone."
        )


def has_points(name: str, beside: Mapping[str, Array], rectified: bool) -> bool:
    """Whether laser or sensor points are listed. Raises `InvalidData` where something beside them cannot be meant."""
    listed = [key for key in POINTS if key in beside]
    if not listed:
        return False
    if both := [key for key in ("x_m", "y_m", "time_offset_bins") if key in beside]:
        raise InvalidData(f"{name}: {', '.join(both)}: {' and '.join(listed)} say it already. Leave it out.")
    if not rectified:
        raise InvalidData(
            f"{name}: {' and '.join(listed)}: where laser and sensor points are listed, times are to count from the "
            "light's arrival at the laser point, less the way from the sensor point to the sensor. Take both off, and "
            "store rectified = 1."
        )
    return True


def at_midpoints_of(name: str, beside: Mapping[str, Array], counts: Array, time: TimeAxis) -> PlacedLight:
    """Histograms (N, T), or (H, W, T), of listed points as what a confocal scan of their midpoints would see.

    Raises `InvalidData` for points that are not as many, not finite, or in no plane z = const even roughly.
    """
    shape, bins = counts.shape[:-1], time.bins
    given = {key: _placed(name, key, beside[key], shape) for key in POINTS if key in beside}
    lasers, sensors = (given.get(key, next(iter(given.values()))) for key in POINTS)
    middle = (lasers + sensors) / 2
    centre = (middle.max(axis=0) + middle.min(axis=0)) / 2
    hills = lasers[:, 2] + sensors[:, 2] - 2 * centre[2]
    extent_m, height_m = float(np.ptp(middle[:, :2], axis=0).max()), float(np.ptp(np.r_[lasers[:, 2], sensors[:, 2]]))
    if height_m > _HILLY * extent_m:
        raise InvalidData(
            f"{name}: {' and '.join(given)}: reach {height_m:.3g} m along z, and {extent_m:.3g} m along the wall. z is "
            "to be what leads from the wall to the hidden scene, x right and y up: turn the points so."
        )
    apart_m = np.linalg.norm((lasers - sensors)[:, :2], axis=1)
    delta_m = time.bin_width_s * SPEED_OF_LIGHT_M_PER_S
    first_m = time.start_s * SPEED_OF_LIGHT_M_PER_S + hills
    longer = max(int(np.ceil(first_m.max() / delta_m)), 0)
    moved = np.empty((len(apart_m), bins + longer), dtype=np.float32)
    for k, histogram in enumerate(counts.reshape(-1, bins)):
        moved[k] = moved_out(np.pad(histogram, (0, longer)), float(apart_m[k]), float(first_m[k]), delta_m)
    notes = []
    if np.abs(centre).max() > 0.01 * extent_m:
        at = ", ".join(f"{value:.3g}" for value in centre)
        notes.append(f"the middle of its points is at ({at}) m; places and depths count from there")
    if apart_m.max() > _FLAT_M:
        notes.append(
            f"laser and sensor points are up to {apart_m.max():.3g} m apart: taken for a confocal scan of midpoints by "
            "normal moveout, which assumes surfaces opposite these; others come out too near"
        )
    if height_m > _FLAT_M:
        notes.append(
            f"the wall is not flat, {height_m:.3g} m from its lowest to its highest point: times are moved to its mean "
            "plane, as is right for surfaces opposite each point"
        )
    x_m, y_m = middle[:, 0] - centre[0], middle[:, 1] - centre[1]
    return PlacedLight(moved, x_m, y_m, TimeAxis(bins + longer, time.bin_width_s), tuple(notes))


def _placed(name: str, key: str, stored: Array, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """Points (N, 3) of a list (..., 3), or (..., 2) on a plane; one point stands for all."""
    count = int(np.prod(shape))
    points = stored.astype(np.float64) if stored.dtype.kind in "uif" else np.full(stored.shape, np.nan)
    if points.size in (2, 3):
        points = np.broadcast_to(points.ravel(), (*shape, points.size))
    if points.ndim < 2 or points.shape[-1] not in (2, 3) or points.shape[:-1] not in (shape, (count,)):
        raise InvalidData(
            f"{name}: {key}: has shape {stored.shape}; {(*shape, 3)} is expected, x, y and z of a point for each "
            "histogram, or one point for all"
        )
    if not np.isfinite(points).all():
        raise InvalidData(f"{name}: {key}: holds values that are no finite numbers of metres")
    points = points.reshape(count, -1)
    return points if points.shape[1] == 3 else np.c_[points, np.zeros(count)]
