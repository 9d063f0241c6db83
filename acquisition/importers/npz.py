"""NPZ scans as `nlos export --to npz` writes them: histograms [H, W, T] on a grid, or [N, T] at free positions."""

import zipfile
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.untrusted_hdf5 import MAX_BYTES
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid

_MAX_RATIO = 1100  # zlib's own limit is about 1032


def read_npz(path: Path) -> ImportedScan:
    """Reads a scan on a grid. Raises `InvalidData` naming file, place and reason."""
    arrays = _arrays(path)
    counts = _numbers(path, arrays, "histograms")
    if counts.ndim == 2:
        raise InvalidData(f"{path}: histograms lie at free positions; import the recording that they came from")
    if counts.ndim != 3 or counts.size == 0:
        raise InvalidData(f"{path}: histograms: has shape {counts.shape}; [H, W, T] is expected")
    rows, cols, bins = counts.shape
    width_s = float(_numbers(path, arrays, "bin_width_s").reshape(-1)[0])
    if not 1e-13 <= width_s <= 1e-6:
        raise InvalidData(f"{path}: bin_width_s is {width_s:g} s; 1e-13 to 1e-6 s make sense")
    notes = []
    if "exposure_s" in arrays:
        exposure = _numbers(path, arrays, "exposure_s").astype(np.float64)
    else:
        exposure = np.ones((rows, cols))
        notes.append("exposure is not stored; 1 s per point is assumed")
    if exposure.shape != (rows, cols):
        raise InvalidData(f"{path}: exposure_s: has shape {exposure.shape}, the scan {(rows, cols)}")
    width_m = _extent(path, arrays, "x_m", cols, notes)
    height_m = _extent(path, arrays, "y_m", rows, notes)
    transient = Transient(
        np.ascontiguousarray(np.moveaxis(counts, 2, 0), dtype=np.float32),
        exposure,
        WallGrid(width_m, height_m, rows, cols),
        TimeAxis(
            bins, width_s, float(_numbers(path, arrays, "offset_s").reshape(-1)[0]) if "offset_s" in arrays else 0.0
        ),
    )
    return ImportedScan(transient, "NPZ", rectified=False, notes=tuple(notes))


def _arrays(path: Path) -> dict[str, npt.NDArray[np.generic]]:
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
        total = sum(member.file_size for member in members)
        if len(members) > 64 or total > MAX_BYTES or total > _MAX_RATIO * max(path.stat().st_size, 1):
            raise InvalidData(f"{path}: states {len(members)} arrays of {total} bytes, which it cannot hold")
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (ValueError, zipfile.BadZipFile, zlib.error, EOFError, OSError, KeyError, NotImplementedError,
            RuntimeError, SyntaxError, MemoryError, TypeError, OverflowError) as error:  # fmt: skip
        if isinstance(error, InvalidData):
            raise
        raise InvalidData(f"{path}: not a readable NPZ file ({type(error).__name__}: {error})") from error


def _numbers(path: Path, arrays: dict[str, npt.NDArray[np.generic]], name: str) -> npt.NDArray[np.generic]:
    array = arrays.get(name)
    if array is None:
        raise InvalidData(f"{path}: no array '{name}'; the file holds {', '.join(sorted(arrays)) or 'nothing'}")
    if array.dtype.kind not in "uif" or array.size == 0:
        raise InvalidData(f"{path}: {name}: holds {array.dtype} {array.shape}, not numbers")
    return array


def _extent(path: Path, arrays: dict[str, npt.NDArray[np.generic]], name: str, points: int, notes: list[str]) -> float:
    """The wall's side: pitch times points, from the positions of columns or rows."""
    if name not in arrays:
        notes.append(f"{name} is not stored; a wall of 1 m is assumed")
        return 1.0
    values = np.unique(_numbers(path, arrays, name).astype(np.float64).round(9))
    if values.size != points or not np.isfinite(values).all():
        raise InvalidData(f"{path}: {name}: holds {values.size} positions for {points} rows or columns")
    return float(np.ptp(values)) * points / (points - 1) if points > 1 else 1.0
