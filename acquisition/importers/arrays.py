"""Histograms and what lies beside them as a scan, on a grid or at free positions: what HDF5, NPZ and MAT share."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.given import Given
from nlos.acquisition.importers.imported import FreePoints
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid, grid_around

_PLACES = re.compile(r"(laser|sensor|camera|detector)(_grid)?_(xyz|x_m|y_m|positions?)")
Beside = Mapping[str, npt.NDArray[Any] | None]


@dataclass(frozen=True)
class StoredArrays:
    """Histograms as a file holds them, in its own order, where they are, and what is beside them."""

    name: str
    """Of the file."""
    place: str
    """Within it."""
    counts: npt.NDArray[Any]
    beside: Beside
    """exposure_s, x_m, y_m."""


def refuse_separate_points(name: str, names: Iterable[str]) -> None:
    """Raises `InvalidData` for a file with places of laser and sensor each, which would be taken for confocal."""
    places = sorted(each for each in names if _PLACES.fullmatch(each))
    if len({each.partition("_")[0] for each in places}) > 1:
        raise InvalidData(
            f"{name}: holds {', '.join(places)}: places of laser and sensor of their own are read from y-tal's HDF5 "
            "(HDF5_TAL: T_Sx_Sy, T_Lx_Ly_Sx_Sy). Write it as that; a confocal scan needs x_m and y_m alone."
        )


def held_scan(
    stored: StoredArrays,
    bin_width_s: float,
    sides_m: tuple[float, float] | None,
    given: Given,
    start_s: float = 0.0,
) -> tuple[Transient | FreePoints, tuple[str, ...]]:
    """The scan, and what was assumed. `sides_m`: None for a wall around free positions. Raises `InvalidData` naming
    file, place and reason."""
    name, counts, beside = stored.name, stored.counts, stored.beside
    if not 1e-13 <= bin_width_s <= 1e-6:
        raise InvalidData(f"{name}: bin_width_s is {bin_width_s:g} s; expected 1e-13 to 1e-6 s")
    exposure = beside.get("exposure_s")
    told = exposure is not None and counts.shape[:-1] == exposure.shape
    counts = given.ordered(counts, f"{name}: {stored.place}", told)
    notes = []
    if exposure is None:
        exposure = np.ones(counts.shape[:-1])
        notes.append("exposure is not stored; assuming 1 s per point")
    elif exposure.shape != counts.shape[:-1]:
        raise InvalidData(f"{name}: exposure_s: has shape {exposure.shape}, the scan {counts.shape[:-1]}")
    exposure = exposure.astype(np.float64)
    time = TimeAxis(counts.shape[-1], bin_width_s, start_s)
    if counts.ndim == 3:
        assert sides_m is not None
        wall = WallGrid(*sides_m, *counts.shape[:2])
        cube = np.ascontiguousarray(np.moveaxis(counts, 2, 0), dtype=np.float32)
        return Transient(cube, exposure, wall, time), tuple(notes)
    x_m, y_m = (_places(name, axis, beside, len(counts)) for axis in ("x_m", "y_m"))
    wall = grid_around(x_m, y_m, sides_m)
    if sides_m is None:
        size = f"{wall.width_m:.3g} x {wall.height_m:.3g} m"
        notes.append(f"the wall's size is not stored; assuming {size} around all points")
    points = FreePoints(np.ascontiguousarray(counts, dtype=np.float32), exposure, x_m, y_m, wall, time)
    return points, tuple(notes)


def _places(name: str, axis: str, beside: Beside, count: int) -> npt.NDArray[np.float64]:
    values = beside.get(axis)
    if values is None:
        raise InvalidData(f"{name}: histograms of 2 dimensions [N, T] need {axis} [N], metres from the wall's centre")
    if values.shape != (count,):
        raise InvalidData(f"{name}: {axis}: has shape {values.shape}; ({count},) is expected, one for each histogram")
    if not np.isfinite(values).all():
        raise InvalidData(f"{name}: {axis}: holds positions that are not finite")
    return values.astype(np.float64)
