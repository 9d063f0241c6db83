"""Confocal captures of y-tal (HDF5_TAL) and of the Zaragoza NLOS dataset, read without y-tal and without its YAML.

Time is in metres of optical path; where the paths to and from the scanner are included, their lengths become the
time offsets. Formats: y-tal 0.20 `tal.io`, Galindo et al., "A dataset for benchmarking time-resolved NLOS imaging".
"""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.untrusted_hdf5 import needed_dataset, needed_number, open_hdf5, read_array
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid

Array = npt.NDArray[np.float64]
_T_SX_SY = 1


def read_ytal(path: Path) -> ImportedScan:
    """Reads a confocal HDF5_TAL capture on a regular grid. Raises `InvalidData` naming file, place and reason."""
    with open_hdf5(path) as file:
        kind = int(needed_number(file, "H_format"))
        if kind != _T_SX_SY:
            raise InvalidData(
                f"{path}: H_format is {kind}; only confocal captures (T_Sx_Sy, 1) can be reconstructed here"
            )
        counts = read_array(needed_dataset(file, "H"), 3)
        sensors = read_array(needed_dataset(file, "sensor_grid_xyz"), 3).astype(np.float64)
        lasers = read_array(needed_dataset(file, "laser_grid_xyz"), 3).astype(np.float64)
        delta_m, start_m = needed_number(file, "delta_t"), needed_number(file, "t_start")
        legs = bool(needed_number(file, "t_accounts_first_and_last_bounces"))
        origins = [_point(file, name) if legs else np.zeros(3) for name in ("laser_xyz", "sensor_xyz")]
    if sensors.shape != lasers.shape or not np.allclose(sensors, lasers, atol=1e-4):
        raise InvalidData(f"{path}: laser and sensor points differ; only confocal captures can be reconstructed here")
    return _upright(path, _Capture("y-tal HDF5", counts, sensors, origins if legs else None, delta_m, start_m))


def read_zaragoza(path: Path) -> ImportedScan:
    """Reads a confocal capture of the Zaragoza dataset; bounces and colours are summed. Raises `InvalidData`."""
    with open_hdf5(path) as file:
        stored = needed_dataset(file, "data")
        if len(stored.shape) != 5:
            raise InvalidData(f"{path}: data has {len(stored.shape)} dimensions; confocal captures have 5")
        data = read_array(stored, 5)
        grid = read_array(needed_dataset(file, "cameraGridPositions"), 3).astype(np.float64)
        delta_m, start_m = needed_number(file, "deltaT"), needed_number(file, "t0")
        origins = [_point(file, "laserPosition"), _point(file, "cameraPosition")]
    # Two axis orders are in use: (sy, sx, bounce, t, colour) and (colour, t, bounce, sx, sy).
    if data.shape[0] <= 3 and data.shape[3:] in (grid.shape[1:], grid.shape[:2]):
        counts = data.sum(axis=(0, 2))
    else:
        counts = np.moveaxis(data.sum(axis=(2, 4)), 2, 0).swapaxes(1, 2)
    if grid.shape == (3, *counts.shape[1:]):
        grid = np.moveaxis(grid, 0, 2)
    return _upright(path, _Capture("Zaragoza HDF5", counts, grid, origins, delta_m, start_m))


@dataclass(frozen=True)
class _Capture:
    """What either format holds. `origins`: the ends of the paths on our side, where these are within the times."""

    name: str
    counts: npt.NDArray[np.generic]  # (T, A, B)
    grid: Array  # (A, B, 3)
    origins: list[Array] | None
    delta_m: float
    start_m: float


def _upright(path: Path, capture: _Capture) -> ImportedScan:
    """The capture turned so that rows run down and columns to the right."""
    counts, grid, delta_m, start_m = capture.counts, capture.grid, capture.delta_m, capture.start_m
    if grid.shape != (*counts.shape[1:], 3):
        raise InvalidData(f"{path}: {counts.shape[1:]} histograms on a grid of shape {grid.shape}")
    if not (np.isfinite(grid).all() and 1e-6 < delta_m < 100 and np.isfinite(start_m)):
        raise InvalidData(f"{path}: grid or time axis is not finite (delta_t {delta_m:g} m, t_start {start_m:g} m)")
    if min(counts.shape[1:]) < 2:
        raise InvalidData(f"{path}: a grid of {counts.shape[1:]} points has no spacing; at least 2 x 2 are needed")
    if np.ptp(grid[:, 0, 0]) > np.ptp(grid[0, :, 0]):
        counts, grid = counts.swapaxes(1, 2), grid.swapaxes(0, 1)
    if grid[0, 0, 0] > grid[0, -1, 0]:
        counts, grid = counts[:, :, ::-1], grid[:, ::-1]
    if grid[0, 0, 1] < grid[-1, 0, 1]:
        counts, grid = counts[:, ::-1], grid[::-1]
    rows, cols = counts.shape[1:]
    pitch_x = (grid[0, -1, 0] - grid[0, 0, 0]) / (cols - 1)
    pitch_y = (grid[0, 0, 1] - grid[-1, 0, 1]) / (rows - 1)
    straight = (
        np.abs(np.diff(grid[..., 0], axis=1) - pitch_x).max() + np.abs(np.diff(grid[..., 1], axis=0) + pitch_y).max()
    )
    if not (pitch_x > 0 and pitch_y > 0) or straight > 0.02 * (pitch_x + pitch_y) or np.ptp(grid[..., 2]) > 1e-3:
        raise InvalidData(f"{path}: its points are not a regular grid in a plane z = const")
    width_s = delta_m / SPEED_OF_LIGHT_M_PER_S
    offsets = np.full((rows, cols), -start_m / delta_m)
    if capture.origins is not None:
        offsets += sum(np.linalg.norm(grid - origin, axis=2) for origin in capture.origins) / delta_m
    transient = Transient(
        np.ascontiguousarray(counts, dtype=np.float32),
        np.ones((rows, cols)),
        WallGrid(float(pitch_x * cols), float(pitch_y * rows), rows, cols),
        TimeAxis(int(counts.shape[0]), width_s),
    )
    rectified = bool((np.abs(offsets) < 1e-6).all())
    notes = ("exposure is not stored; assuming 1 s per point", "scene description and normals are not imported")
    return ImportedScan(
        transient,
        capture.name,
        falloff=4,
        rectified=rectified,
        time_offset_bins=None if rectified else offsets,
        notes=notes,
    )


def _point(file: h5py.File, name: str) -> Array:
    dataset = needed_dataset(file, name)
    if dataset.size != 3 or dataset.dtype.kind not in "uif":
        raise InvalidData(f"{file.filename}: {name}: must be three numbers (found {dataset.dtype} {dataset.shape})")
    return np.asarray(dataset[()], dtype=np.float64).reshape(3)
