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
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.own_data import how_to_convert
from nlos.acquisition.importers.untrusted_hdf5 import find_dataset, open_hdf5, read_array

DIFFUSE = 4


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
                f"{path}: no dataset '{dataset}' [H, W, T], or [N, T] with x_m and y_m [N]; the file holds {present}. "
                f"{how_to_convert()}"
            )
        counts = read_array(stored, 2 if len(stored.shape) == 2 else 3)
        beside = {name: held for name in KNOWN if (held := _beside(path, file, name)) is not None}
        others = tuple({*file.keys(), *file.attrs.keys()} - {dataset, *KNOWN})
    return scan_of(StoredArrays(str(path), "plain HDF5", dataset, counts, beside, others, DIFFUSE), given)


def _beside(path: Path, file: h5py.File, name: str) -> npt.NDArray[Any] | None:
    """What goes with the histograms, an attribute or a dataset. Raises `InvalidData` where these differ."""
    stored = find_dataset(file, name)
    attribute = np.asarray(file.attrs[name]) if name in file.attrs else None
    if stored is None or stored.shape is None:
        return attribute
    array = read_array(stored, len(stored.shape))
    if attribute is not None and not np.array_equal(attribute.ravel(), np.ravel(array)):
        raise InvalidData(f"{path}: {name}: is an attribute and a dataset of different values. Leave one out.")
    return np.asarray(array)
