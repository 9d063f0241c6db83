"""Plain HDF5 scans: `histograms` [H, W, T], or [N, T] at `x_m`, `y_m` [N], and a few attributes; read as they stand.

Attributes: `bin_width_s`, `wall_size_m` (one number, or width and height; free positions do without); optionally
`direct_cut_bins`, `falloff_exponent_authors` (2 or 4), `rectified` (default 1), `response_fwhm_ps`, and datasets
`exposure_s` and `time_offset_bins` [H, W], and `response`, a curve over bins of `response_bin_width_s`.
"""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.arrays import StoredArrays, held_scan, refuse_separate_points
from nlos.acquisition.importers.given import NOTHING, Given, put_there
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.untrusted_hdf5 import find_dataset, open_hdf5, read_array
from nlos.acquisition.response import stated

_SINGLE = ("exposure_s", "x_m", "y_m", "time_offset_bins")


def read_plain(path: Path, dataset: str = "histograms", given: Given = NOTHING) -> ImportedScan:
    """Reads one plain HDF5 scan. Raises `InvalidData` naming file, place and reason."""
    with open_hdf5(path) as file:
        stored = find_dataset(file, dataset)
        if stored is None:
            if file.attrs.get("format") == "nlos-constants":
                raise InvalidData(
                    f"{path}: holds a bench's constants, not a scan. Name the recording; constants go with --constants."
                )
            present = ", ".join(sorted(file.keys())[:12]) or "nothing"
            raise InvalidData(
                f"{path}: no dataset '{dataset}' [H, W, T], or [N, T] with x_m and y_m [N]; the file holds {present}"
            )
        refuse_separate_points(str(path), file.keys())
        counts = read_array(stored, 2 if len(stored.shape) == 2 else 3)
        beside = {name: _beside(file, name) for name in _SINGLE}
        width_s = given.bin_width_s or _number(file, "bin_width_s", "--bin-width-ps PS")
        sides_m = given.wall_m or _wall_size(file, needed=counts.ndim == 3)
        cut = int(_number(file, "direct_cut_bins", default=0))
        falloff = int(_number(file, "falloff_exponent_authors", default=4))
        rectified = bool(_number(file, "rectified", default=1))
        curve = _beside(file, "response")
        step_s, fwhm_ps = (
            _number(file, name) if name in file.attrs else None for name in ("response_bin_width_s", "response_fwhm_ps")
        )
    if falloff not in (2, 4):
        raise InvalidData(f"{path}: falloff_exponent_authors is {falloff}; 2 or 4 are known")
    held, notes = held_scan(StoredArrays(str(path), dataset, counts, beside), width_s, sides_m, given)
    if not 0 <= cut < held.time.bins:
        raise InvalidData(f"{path}: direct_cut_bins is {cut}, but histograms have {held.time.bins} bins")
    offsets = beside["time_offset_bins"]
    if offsets is not None and offsets.shape != held.exposure_s.shape:
        raise InvalidData(f"{path}: time_offset_bins has shape {offsets.shape}, the scan {held.exposure_s.shape}")
    return ImportedScan(
        held,
        "plain HDF5",
        direct_cut_bins=cut,
        falloff=falloff,
        rectified=rectified,
        time_offset_bins=offsets,
        response=stated(curve, step_s, fwhm_ps, str(path)),
        notes=notes,
    )


def _beside(file: h5py.File, name: str) -> npt.NDArray[Any] | None:
    """An array that goes with the histograms, where the file has it."""
    stored = find_dataset(file, name)
    return None if stored is None else read_array(stored, len(stored.shape)).astype(np.float64)


def _number(file: h5py.File, key: str, option: str | None = None, default: float | None = None) -> float:
    value = file.attrs.get(key, default)
    array = np.asarray(value)
    if value is None or array.size != 1 or array.dtype.kind not in "uifb" or not np.isfinite(array).all():
        remedy = f". {put_there(option)}" if option else ""
        raise InvalidData(f"{file.filename}: attribute {key} must be one finite number (found {value!r}){remedy}")
    return float(array.reshape(()))


def _wall_size(file: h5py.File, needed: bool) -> tuple[float, float] | None:
    value = file.attrs.get("wall_size_m")
    if value is None and not needed:
        return None
    array = np.asarray(value)
    if value is None or array.dtype.kind not in "uif" or array.size not in (1, 2):
        raise InvalidData(
            f"{file.filename}: attribute wall_size_m must be one number or width and height (found {value!r}). "
            f"{put_there('--wall-size-m W or WxH')}"
        )
    sizes = array.astype(np.float64).ravel()
    if not (np.isfinite(sizes).all() and (sizes > 0).all()):
        raise InvalidData(f"{file.filename}: wall_size_m is {value!r}; metres above 0 are expected")
    return float(sizes[0]), float(sizes[-1])
