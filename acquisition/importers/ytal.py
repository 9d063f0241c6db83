"""Captures of y-tal (HDF5_TAL) and of the Zaragoza NLOS dataset, read without y-tal and without its YAML. Those whose
laser and sensor points differ are taken for confocal ones of their midpoints (`moveout`).

Time is in metres of optical path; where the paths to and from the scanner are included, their lengths become the
time offsets. Formats: y-tal 0.20 `tal.io`, Galindo et al., "A dataset for benchmarking time-resolved NLOS imaging".
"""

from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
import yaml

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.missing_direct import SAID, direct_is_missing
from nlos.acquisition.importers.moveout import at_midpoints, of_every_pair
from nlos.acquisition.importers.untrusted_hdf5 import find_dataset, needed_dataset, needed_number, open_hdf5, read_array
from nlos.acquisition.importers.wall_plane import on_wall
from nlos.acquisition.importers.ytal_lists import ListedPoints, at_free_positions
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient, as_floats
from nlos.acquisition.wall import WallGrid

Array = npt.NDArray[np.float64]
_T_SX_SY, _T_LX_LY_SX_SY, _T_SI = 1, 2, 3
_OTHERS = {4.0: "T_Li_Si"}


def read_ytal(path: Path) -> ImportedScan:
    """Reads an HDF5_TAL capture on regular grids, or of a list of points. Raises `InvalidData` naming file, place and
    reason."""
    with open_hdf5(path) as file:
        kind = needed_number(file, "H_format")
        if kind not in (_T_SX_SY, _T_LX_LY_SX_SY, _T_SI):
            raise InvalidData(
                f"{path}: H_format is {kind:g} ({_OTHERS.get(kind, 'unknown')}); T_Sx_Sy (1) and T_Si (3) are read, "
                "confocal or of one laser point, and T_Lx_Ly_Sx_Sy (2). Write its points as a grid (X_Y_3), or the "
                "pairs that were measured as a list."
            )
        stored, expected = needed_dataset(file, "H"), {_T_SX_SY: 3, _T_LX_LY_SX_SY: 5, _T_SI: 2}[int(kind)]
        if len(stored.shape or ()) == expected + 1 and stored.shape[-1] == 4:
            raise InvalidData(
                f"{path}: H: has shape {stored.shape}: a polarised capture, of four Stokes components? Write the first "
                "alone, which is the intensity: H[..., 0]"
            )
        counts = read_array(stored, expected)
        axes = 2 if kind == _T_SI else 3
        sensors = read_array(needed_dataset(file, "sensor_grid_xyz"), axes).astype(np.float64)
        lasers = read_array(needed_dataset(file, "laser_grid_xyz"), axes).astype(np.float64)
        delta_m, start_m = needed_number(file, "delta_t"), needed_number(file, "t_start")
        legs = bool(needed_number(file, "t_accounts_first_and_last_bounces"))
        origins = [_point(file, name) if legs else np.zeros(3) for name in ("laser_xyz", "sensor_xyz")]
        hints = _sides(file, sensors, ("sensor_xyz", "laser_xyz"), "sensor_grid_normals")
        ours = _said_by_ourselves(file)
    _check_time(path, delta_m, start_m)
    if kind == _T_SI:
        listed = ListedPoints(
            counts, lasers, sensors, (origins[0], origins[1]) if legs else None, delta_m, start_m, hints
        )
        return _as_exported(at_free_positions(path, listed, ours), ours)
    if kind == _T_SX_SY and sensors.shape == lasers.shape and np.allclose(sensors, lasers, atol=1e-4):
        exposure_s = _exposure_s(ours, sensors)
        capture = _Capture(
            "y-tal HDF5", counts, sensors, origins if legs else None, delta_m, start_m, exposure_s, hints=hints
        )
        return _as_exported(_upright(path, capture), ours)
    _check_geometry(path, counts, lasers, sensors)
    ways = [
        np.linalg.norm(grid - origin, axis=2) * legs for grid, origin in zip((lasers, sensors), origins, strict=True)
    ]
    if kind == _T_SX_SY:
        done = at_midpoints(
            counts, np.broadcast_to(lasers, sensors.shape), sensors, start_m - ways[0] - ways[1], delta_m
        )
    else:
        first_m = start_m - ways[0][:, :, None, None] - ways[1][None, None]
        done = of_every_pair(counts, lasers, sensors, first_m, delta_m)
    note = (
        f"laser and sensor points are up to {done.farthest_m:.3g} m apart: taken for a confocal scan of midpoints "
        "by normal moveout, which assumes surfaces opposite these; others come out too near"
    )
    moved = _Capture("y-tal HDF5", done.counts, done.grid, None, delta_m, 0.0, done.pairs, (note,), hints)
    return _upright(path, moved)


def _said_by_ourselves(file: h5py.File) -> dict[str, object]:
    """What `nlos export` put beside the capture, as JSON or, once y-tal has written it again, as YAML; empty for
    everybody else's."""
    stored = find_dataset(file, "scene_info")
    text = stored[()] if stored is not None and stored.shape == () else b""
    if not isinstance(text, bytes) or b"original_format" not in text:
        return {}
    try:
        said = yaml.load(bytes(text), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, ValueError, RecursionError):
        return {}
    return said if isinstance(said, dict) and said.get("original_format") == "nlos" else {}


def _exposure_s(ours: dict[str, object], grid: Array) -> Array | None:
    """Seconds per point [x, y] as exported; None where nobody says so, and where points were taken away, added up or
    turned round since: whose exposure is whose is then not known."""
    told, (corner, opposite) = ours.get("exposure_us"), (grid[0, 0], grid[-1, -1])
    try:
        exposure_us = np.asarray(told, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    if exposure_us.shape != grid.shape[:2] or not (corner[:2] < opposite[:2]).all():
        return None
    return exposure_us * 1e-6


def _as_exported(scan: ImportedScan, ours: dict[str, object]) -> ImportedScan:
    """The scan with what y-tal's own fields do not say: that a raw scan is raw though nothing tells its scanner's
    place, whether anybody measured the wall, and the light's falloff."""
    if not ours:
        return scan
    cut, falloff = ours.get("direct_cut_bins"), ours.get("falloff_exponent_authors")
    return replace(
        scan,
        rectified=scan.rectified and ours.get("rectified") is not False,
        wall_known=ours.get("wall_known") is not False,
        direct_cut_bins=cut if isinstance(cut, int) else 0,
        falloff=falloff if isinstance(falloff, int) else None,
    )


def _check_time(path: Path, delta_m: float, start_m: float) -> None:
    if not (1e-6 < delta_m < 100 and np.isfinite(start_m)):
        raise InvalidData(f"{path}: its time axis is not finite (delta_t {delta_m:g} m, t_start {start_m:g} m)")


def _check_geometry(path: Path, counts: npt.NDArray[np.generic], lasers: Array, sensors: Array) -> None:
    """Raises `InvalidData` for laser and sensor points that have no midpoints on a regular grid."""
    what = f"{path}: laser and sensor points differ, so it is no confocal capture, and"
    if not (np.isfinite(lasers).all() and np.isfinite(sensors).all()):
        raise InvalidData(f"{path}: laser or sensor grid is not finite")
    if max(np.ptp(lasers[..., 2]), np.ptp(sensors[..., 2]), abs(lasers[0, 0, 2] - sensors[0, 0, 2])) > 1e-3:
        raise InvalidData(f"{what} they are not in one plane z = const: normal moveout cannot make one of it")
    if counts.ndim == 3:
        if lasers.shape[:2] not in ((1, 1), sensors.shape[:2]) or counts.shape[1:] != sensors.shape[:2]:
            raise InvalidData(
                f"{what} {counts.shape[1:]} histograms, {lasers.shape[:2]} laser and {sensors.shape[:2]} sensor points "
                "do not belong together: one laser point, or one for each sensor point, is expected"
            )
    elif lasers.shape != sensors.shape or counts.shape[1:] != lasers.shape[:2] + sensors.shape[:2]:
        raise InvalidData(
            f"{what} {counts.shape[1:]} histograms on grids of {lasers.shape[:2]} laser and {sensors.shape[:2]} sensor "
            "points have no common midpoints. Write those of one laser point (T_Sx_Sy), or of one grid for both."
        )
    elif not np.allclose(np.diff(lasers, axis=0), np.diff(sensors, axis=0), atol=1e-4) or not np.allclose(
        np.diff(lasers, axis=1), np.diff(sensors, axis=1), atol=1e-4
    ):
        raise InvalidData(
            f"{what} their grids have different spacings. Write the histograms of one laser point (T_Sx_Sy), or of one "
            "grid for both."
        )


def read_zaragoza(path: Path) -> ImportedScan:
    """Reads a confocal capture of the Zaragoza dataset; bounces and colours are summed. Raises `InvalidData`."""
    with open_hdf5(path) as file:
        stored = needed_dataset(file, "data")
        grid = read_array(needed_dataset(file, "cameraGridPositions"), 3).astype(np.float64)
        by_matlab = len(stored.shape) == 4 and grid.shape == (3, *stored.shape[2:])  # which drops a last axis of 1
        if len(stored.shape) != 5 and not by_matlab:
            raise InvalidData(
                f"{path}: data has {len(stored.shape)} dimensions; confocal captures have 5. One of separate laser and "
                "sensor points is read as y-tal writes it (HDF5_TAL): `tal.io.read_capture`, then `write_capture`."
            )
        data = read_array(stored, 4)[None] if by_matlab else read_array(stored, 5)
        delta_m, start_m = needed_number(file, "deltaT"), needed_number(file, "t0")
        origins = [_point(file, "laserPosition"), _point(file, "cameraPosition")]
        upright = np.moveaxis(grid, 0, 2) if grid.shape[0] == 3 and grid.shape[2] != 3 else grid
        hints = _sides(file, upright, ("hiddenVolumePosition", "cameraPosition"), "cameraGridNormals")
    # Two axis orders are in use: (colour, t, bounce, sx, sy) with a grid (3, sx, sy), and all of it reversed:
    # (sy, sx, bounce, t, colour) with (sy, sx, 3). Reversed data beside a grid (3, sx, sy) are met, too.
    if data.shape[0] <= 3 and data.shape[3:] in (grid.shape[1:], grid.shape[:2]):
        counts = data.sum(axis=(0, 2))
    else:
        counts = np.moveaxis(data.sum(axis=(2, 4)), 2, 0)
        if grid.shape != (*counts.shape[1:], 3):
            counts = counts.swapaxes(1, 2)
    if grid.shape == (3, *counts.shape[1:]):
        grid = np.moveaxis(grid, 0, 2)
    return _upright(path, _Capture("Zaragoza HDF5", counts, grid, origins, delta_m, start_m, hints=hints))


@dataclass(frozen=True)
class _Capture:
    """What either format holds. `origins`: the ends of the paths on our side, where these are within the times."""

    name: str
    counts: npt.NDArray[np.generic]  # (T, A, B)
    grid: Array  # (A, B, 3)
    origins: list[Array] | None
    delta_m: float
    start_m: float
    exposure_s: Array | None = None
    """Where it is not one second per point."""
    notes: tuple[str, ...] = ()
    hints: tuple[Array, ...] = ()
    """From the wall to the hidden scene, as `on_wall` takes them."""


def _sides(file: h5py.File, grid: Array, points: tuple[str, ...], normals: str) -> tuple[Array, ...]:
    """Vectors from the wall to the hidden scene's side, by what is stored: points on that side, else the normals."""
    middle, found = grid.reshape(-1, 3).mean(axis=0), []
    for name in points:
        stored = find_dataset(file, name)
        if stored is not None and stored.shape is not None and stored.size == 3 and stored.dtype.kind in "uif":
            found.append(_point(file, name) - middle)
    stored = find_dataset(file, normals)
    if stored is not None and stored.shape is not None and 3 in stored.shape and stored.dtype.kind in "uif":
        every = read_array(stored, len(stored.shape)).astype(np.float64)
        axis = 0 if every.shape[0] == 3 and every.shape[-1] != 3 else -1
        found.append(np.moveaxis(every, axis, -1).reshape(-1, 3).mean(axis=0))
    return tuple(each for each in found if np.isfinite(each).all())


def _upright(path: Path, capture: _Capture) -> ImportedScan:
    """The capture turned so that rows run down and columns to the right."""
    counts, grid, delta_m, start_m = capture.counts, capture.grid, capture.delta_m, capture.start_m
    exposure_s = np.ones(grid.shape[:2]) if capture.exposure_s is None else capture.exposure_s
    if grid.shape != (*counts.shape[1:], 3):
        raise InvalidData(f"{path}: {counts.shape[1:]} histograms on a grid of shape {grid.shape}")
    _check_time(path, delta_m, start_m)
    if not np.isfinite(grid).all():
        raise InvalidData(f"{path}: its grid is not finite")
    if min(counts.shape[1:]) < 2:
        raise InvalidData(f"{path}: a grid of {counts.shape[1:]} points has no spacing; at least 2 x 2 are needed")
    places, faces = on_wall(str(path), grid, list(capture.hints))
    if np.ptp(places[:, 0, 0]) > np.ptp(places[0, :, 0]):
        counts, exposure_s = counts.swapaxes(1, 2), exposure_s.T
        grid, places = grid.swapaxes(0, 1), places.swapaxes(0, 1)
    if places[0, 0, 0] > places[0, -1, 0]:
        counts, exposure_s = counts[:, :, ::-1], exposure_s[:, ::-1]
        grid, places = grid[:, ::-1], places[:, ::-1]
    if places[0, 0, 1] < places[-1, 0, 1]:
        counts, exposure_s, grid, places = counts[:, ::-1], exposure_s[::-1], grid[::-1], places[::-1]
    rows, cols = counts.shape[1:]
    pitch_x = (places[0, -1, 0] - places[0, 0, 0]) / (cols - 1)
    pitch_y = (places[0, 0, 1] - places[-1, 0, 1]) / (rows - 1)
    straight = (
        np.abs(np.diff(places[..., 0], axis=1) - pitch_x).max()
        + np.abs(np.diff(places[..., 1], axis=0) + pitch_y).max()
    )
    if not (pitch_x > 0 and pitch_y > 0) or straight > 0.02 * (pitch_x + pitch_y):
        raise InvalidData(f"{path}: its points are not a regular grid")
    width_s = delta_m / SPEED_OF_LIGHT_M_PER_S
    late_m = start_m if capture.origins is None and start_m > 0 else 0.0  # the record begins after the wall's light
    offsets = np.full((rows, cols), (late_m - start_m) / delta_m)
    if capture.origins is not None:
        offsets += sum(np.linalg.norm(grid - origin, axis=2) for origin in capture.origins) / delta_m
    transient = Transient(
        as_floats(counts),
        np.ascontiguousarray(exposure_s),
        WallGrid(float(pitch_x * cols), float(pitch_y * rows), rows, cols),
        TimeAxis(int(counts.shape[0]), width_s, late_m / SPEED_OF_LIGHT_M_PER_S),
    )
    rectified = bool((np.abs(offsets) < 1e-6).all())
    only_offsets = not rectified and direct_is_missing(counts, offsets)
    found = (*capture.notes, *faces, *([SAID] if only_offsets else []))
    notes = ["scene description and normals are not imported"]
    if capture.exposure_s is None:
        notes.insert(0, "exposure is not stored; assuming 1 s per point")
    return ImportedScan(
        transient,
        capture.name,
        falloff=4,
        rectified=rectified,
        time_offset_bins=None if rectified else offsets,
        no_direct_light=only_offsets,
        notes=(*found, *notes),
    )


def _point(file: h5py.File, name: str) -> Array:
    dataset = needed_dataset(file, name)
    if dataset.size != 3 or dataset.dtype.kind not in "uif":
        raise InvalidData(f"{file.filename}: {name}: must be three numbers (found {dataset.dtype} {dataset.shape})")
    return np.asarray(dataset[()], dtype=np.float64).reshape(3)
