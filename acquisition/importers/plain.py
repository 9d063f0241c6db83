"""Plain HDF5 scans: `histograms` [H, W, T], or [N, T] at `x_m`, `y_m` [N], and what lies beside them as attributes or
datasets: see `arrays` for the names."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.arrays import KNOWN, StoredArrays, scan_of
from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.grid_places import EvenGrid, on_even_grid
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.own_data import how_to_convert
from nlos.acquisition.importers.untrusted_hdf5 import find_dataset, open_hdf5, read_array

DIFFUSE = 4
_OF_HDF5 = ("CLASS", "DIMENSION_LIST", "DIMENSION_LABELS", "NAME", "REFERENCE_LIST")
"""Attributes that libraries write for themselves."""
_PACKING = ("_FillValue", "missing_value", "scale_factor", "add_offset")
"""What netCDF-4 (xarray, say) tells of numbers that are not stored as they are: CF conventions 1.11, 2.5.1 and 8.1."""


def read_plain(path: Path, dataset: str = "histograms", given: Given = NOTHING) -> ImportedScan:
    """Reads one plain HDF5 scan. Raises `InvalidData` naming file, place and reason."""
    with open_hdf5(path) as file:
        stored = find_dataset(file, dataset)
        if stored is None:
            if file.attrs.get("format") == "nlos-constants":
                raise InvalidData(
                    f"{path}: holds a bench's constants, not a scan. Name the recording; constants go with --constants."
                )
            if {"albedo", "depth_m"} <= set(file.keys()):
                raise InvalidData(f"{path}: is a reconstruction, not a scan. Name the recording that it was made from.")
            present = ", ".join(sorted(file.keys())[:12]) or "nothing"
            raise InvalidData(
                f"{path}: no dataset '{dataset}' [H, W, T], or [N, T] with x_m and y_m [N]; the file holds {present}. "
                f"{how_to_convert()}"
            )
        dimensions = len(stored.shape or ())
        counts = _as_meant(path, stored, read_array(stored, dimensions if dimensions in (2, 4, 5) else 3))
        beside = {name: held for name in KNOWN if (held := _beside(path, file, stored, name)) is not None}
        said = {name for name in stored.attrs if name not in _OF_HDF5}
        others = tuple({*file.keys(), *file.attrs.keys(), *said} - {dataset, *KNOWN, *_PACKING})
    return scan_of(StoredArrays(str(path), "plain HDF5", dataset, counts, beside, others, DIFFUSE), given)


def grid_of(path: Path, file: h5py.File, shape: tuple[int, ...]) -> EvenGrid:
    """How a file's arrays (H, W) stand, by the places `x_m` and `y_m` of its columns and rows. Raises `InvalidData` for
    places that are no even grid."""
    x_m, y_m = (_beside(path, file, file, axis) for axis in ("x_m", "y_m"))
    rows, cols = shape
    return on_even_grid(str(path), (rows, cols), None, x_m, y_m, told=False)


def _beside(path: Path, file: h5py.File, histograms: h5py.File | h5py.Dataset, name: str) -> npt.NDArray[Any] | None:
    """What goes with the histograms: an attribute of the file or of their dataset, or a dataset. Raises `InvalidData`
    where these differ."""
    stored = find_dataset(file, name)
    said = [np.asarray(item.attrs[name]) for item in (file, histograms) if name in item.attrs]
    if stored is not None and stored.shape is not None:
        said.append(_as_meant(path, stored, np.asarray(read_array(stored, len(stored.shape)))))
    if any(not np.array_equal(each.ravel(), said[0].ravel()) for each in said[1:]):
        raise InvalidData(f"{path}: {name}: is an attribute and a dataset of different values. Leave one out.")
    return said[-1] if said else None


def _as_meant(path: Path, stored: h5py.Dataset, numbers: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Numbers as a netCDF-4 file means them: unpacked, and NaN where it says that there are none. Raises
    `InvalidData`."""
    said = {name: np.asarray(stored.attrs[name]) for name in _PACKING if name in stored.attrs}
    if wrong := [name for name, value in said.items() if value.dtype.kind not in "uif" or value.size != 1]:
        raise InvalidData(f"{path}: {stored.name.lstrip('/')}: {wrong[0]} of it is not one number")
    none = [value for name in _PACKING[:2] if (value := said.get(name)) is not None]
    absent = np.logical_or.reduce([numbers == value for value in none]) if none else np.zeros(1, bool)
    scale, offset = (said.get(name) for name in _PACKING[2:])
    if scale is not None or offset is not None:
        numbers = numbers * np.float64(1 if scale is None else scale) + np.float64(0 if offset is None else offset)
    return np.where(absent, np.nan, numbers) if absent.any() else numbers
