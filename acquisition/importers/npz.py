"""NPZ scans as `nlos export --to npz` writes them: histograms [H, W, T] on a grid, or [N, T] at free positions."""

import zipfile
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.arrays import StoredArrays, held_scan, refuse_separate_points
from nlos.acquisition.importers.given import NOTHING, Given, put_there
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.untrusted_hdf5 import MAX_BYTES
from nlos.acquisition.response import stated

_MAX_RATIO = 1100  # zlib's own limit is about 1032


def read_npz(path: Path, given: Given = NOTHING) -> ImportedScan:
    """Reads a scan. Raises `InvalidData` naming file, place and reason."""
    arrays = _arrays(path)
    refuse_separate_points(str(path), arrays)
    counts = _numbers(path, arrays, "histograms")
    if counts.ndim not in (2, 3):
        raise InvalidData(f"{path}: histograms: has shape {counts.shape}; [H, W, T] or [N, T] is expected")
    if given.bin_width_s is None and "bin_width_s" not in arrays:
        raise InvalidData(
            f"{path}: no array 'bin_width_s'; the file holds {_listed(arrays)}. {put_there('--bin-width-ps PS')}"
        )
    width_s = given.bin_width_s or _number(path, arrays, "bin_width_s")
    start_s = _number(path, arrays, "offset_s") if "offset_s" in arrays else 0.0
    beside = {
        name: _numbers(path, arrays, name).astype(np.float64) if name in arrays else None
        for name in ("exposure_s", "x_m", "y_m")
    }
    notes: list[str] = []
    sides_m = given.wall_m
    if sides_m is None and counts.ndim == 3:
        ordered = given.ordered(counts, f"{path}: histograms", told=True)
        rows, cols = ordered.shape[:2]
        sides_m = _extent(path, arrays, "x_m", cols, notes), _extent(path, arrays, "y_m", rows, notes)
    held, more = held_scan(StoredArrays(str(path), "histograms", counts, beside), width_s, sides_m, given, start_s)
    rectified = "rectified" in arrays and bool(_number(path, arrays, "rectified"))
    known = given.wall_m is not None or counts.ndim == 2 or not notes
    curve = _numbers(path, arrays, "response") if "response" in arrays else None
    step_s, fwhm_ps = (
        _number(path, arrays, name) if name in arrays else None for name in ("response_bin_width_s", "response_fwhm_ps")
    )
    response = stated(curve, step_s, fwhm_ps, str(path))
    return ImportedScan(held, "NPZ", rectified=rectified, wall_known=known, response=response, notes=(*notes, *more))


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
        raise InvalidData(f"{path}: no array '{name}'; the file holds {_listed(arrays)}")
    if array.dtype.kind not in "uif" or array.size == 0:
        raise InvalidData(f"{path}: {name}: holds {array.dtype} {array.shape}, not numbers")
    return array


def _number(path: Path, arrays: dict[str, npt.NDArray[np.generic]], name: str) -> float:
    value = float(np.asarray(_numbers(path, arrays, name), dtype=np.float64).ravel()[0])
    if not np.isfinite(value):
        raise InvalidData(f"{path}: {name}: is {value:g}, not a number")
    return value


def _listed(arrays: dict[str, npt.NDArray[np.generic]]) -> str:
    return ", ".join(sorted(arrays)) or "nothing"


def _extent(path: Path, arrays: dict[str, npt.NDArray[np.generic]], name: str, points: int, notes: list[str]) -> float:
    """The wall's side: pitch times points, from the positions of columns or rows."""
    if name not in arrays:
        notes.append(f"{name} is not stored; assuming a wall of 1 m")
        return 1.0
    values = np.unique(_numbers(path, arrays, name).astype(np.float64).round(9))
    if values.size != points or not np.isfinite(values).all():
        raise InvalidData(f"{path}: {name}: holds {values.size} positions for {points} rows or columns")
    if points == 1:
        notes.append(f"{name} holds one position; assuming a wall of 1 m")
        return 1.0
    return float(np.ptp(values)) * points / (points - 1)
