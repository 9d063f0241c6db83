"""Plain HDF5 scans: `histograms` [H, W, T] and a few attributes, read without conversion.

Attributes: `bin_width_s`, `wall_size_m` (one number, or width and height); optionally `direct_cut_bins`,
`falloff_exponent_authors` (2 or 4) and a dataset `time_offset_bins` [H, W].
"""

from pathlib import Path

import h5py
import numpy as np

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.untrusted_hdf5 import find_dataset, open_hdf5, read_array
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid


def read_plain(path: Path, dataset: str = "histograms") -> ImportedScan:
    """Reads one plain HDF5 scan; exposure 1 s everywhere. Raises `InvalidData` naming file, place and reason."""
    with open_hdf5(path) as file:
        stored = find_dataset(file, dataset)
        if stored is None:
            present = ", ".join(sorted(file.keys())[:12]) or "nothing"
            raise InvalidData(f"{path}: no dataset '{dataset}' [H, W, T]; the file holds {present}")
        counts = read_array(stored, 3)
        bin_width_s = _number(file, "bin_width_s")
        if not 1e-13 <= bin_width_s <= 1e-6:
            raise InvalidData(f"{path}: bin_width_s is {bin_width_s:g} s; 1e-13 to 1e-6 s make sense")
        width_m, height_m = _wall_size(file)
        cut = int(_number(file, "direct_cut_bins", 0))
        rows, cols, bins = counts.shape
        if not 0 <= cut < bins:
            raise InvalidData(f"{path}: direct_cut_bins is {cut}, but histograms have {bins} bins")
        falloff = int(_number(file, "falloff_exponent_authors", 4))
        if falloff not in (2, 4):
            raise InvalidData(f"{path}: falloff_exponent_authors is {falloff}; 2 or 4 are known")
        offsets = find_dataset(file, "time_offset_bins")
        offset_bins = None if offsets is None else read_array(offsets, 2).astype(np.float64)
        rectified = bool(_number(file, "rectified", 1))
    if offset_bins is not None and offset_bins.shape != (rows, cols):
        raise InvalidData(f"{path}: time_offset_bins has shape {offset_bins.shape}, the scan {(rows, cols)}")
    transient = Transient(
        counts=np.ascontiguousarray(np.moveaxis(counts, 2, 0), dtype=np.float32),
        exposure_s=np.ones((rows, cols)),
        wall=WallGrid(width_m, height_m, rows, cols),
        time=TimeAxis(bins, bin_width_s),
    )
    return ImportedScan(
        transient,
        "plain HDF5",
        direct_cut_bins=cut,
        falloff=falloff,
        rectified=rectified,
        time_offset_bins=offset_bins,
        notes=("exposure is not stored; 1 s per point is assumed",),
    )


def _number(file: h5py.File, key: str, default: float | None = None) -> float:
    value = file.attrs.get(key, default)
    array = np.asarray(value)
    if value is None or array.size != 1 or array.dtype.kind not in "uifb" or not np.isfinite(array).all():
        raise InvalidData(f"{file.filename}: attribute {key} must be one finite number (found {value!r})")
    return float(array.reshape(()))


def _wall_size(file: h5py.File) -> tuple[float, float]:
    value = file.attrs.get("wall_size_m")
    array = np.asarray(value)
    if value is None or array.dtype.kind not in "uif" or array.size not in (1, 2):
        raise InvalidData(
            f"{file.filename}: attribute wall_size_m must be one number or width and height (found {value!r})"
        )
    sizes = array.astype(np.float64).ravel()
    if not (np.isfinite(sizes).all() and (sizes > 0).all()):
        raise InvalidData(f"{file.filename}: wall_size_m is {value!r}; metres above 0 are expected")
    return float(sizes[0]), float(sizes[-1])
