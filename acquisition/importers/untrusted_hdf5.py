"""HDF5 files from outside: opened without following links, read without trusting the sizes that they state."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData

MAX_BYTES = 8 << 30
"""Largest array read, as float32: a 1024 x 1024 x 2048 scan."""
LARGE_BYTES = 256 << 20
MAX_RATIO = 2000
"""Above `LARGE_BYTES`, more than this many bytes out of one stored byte is a decompression bomb, not a measurement."""


@contextmanager
def open_hdf5(path: Path) -> Iterator[h5py.File]:
    """The file, read-only. Raises `InvalidData` where it is not HDF5, also while reading inside the block."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        with h5py.File(path, "r", locking="best-effort") as file:
            yield file
    except (OSError, RuntimeError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise InvalidData(f"{path}: not a readable HDF5 file ({error}). Is the copy complete?") from error


def find_dataset(file: h5py.File, name: str) -> h5py.Dataset | None:
    """The dataset called `name` at the top of the file, None where there is none. Links out of the file are refused."""
    link = file.get(name, getlink=True) if name in file.keys() else None  # noqa: SIM118 - `in file` follows links
    if link is None:
        return None
    if not isinstance(link, h5py.HardLink):
        raise InvalidData(f"{file.filename}: {name}: is a link to elsewhere; links are not followed")
    item = file[name]
    if not isinstance(item, h5py.Dataset):
        return None
    if item.is_virtual or item.external:
        raise InvalidData(f"{file.filename}: {name}: its data lie in other files; copy them into one file")
    return item


def read_array(dataset: h5py.Dataset, dimensions: int) -> npt.NDArray[np.generic]:
    """All of `dataset`, after its type, dimensions and size were checked. Raises `InvalidData`."""
    place = f"{dataset.file.filename}: {dataset.name.lstrip('/')}"
    if dataset.dtype.kind not in "uif":
        raise InvalidData(f"{place}: holds {dataset.dtype}, not numbers")
    if len(dataset.shape) != dimensions:
        raise InvalidData(f"{place}: has {len(dataset.shape)} dimensions ({dataset.shape}); {dimensions} are expected")
    size = int(np.prod([int(n) for n in dataset.shape], dtype=object)) * max(dataset.dtype.itemsize, 4)
    if size == 0:
        raise InvalidData(f"{place}: is empty (shape {dataset.shape})")
    if size > MAX_BYTES:
        raise InvalidData(f"{place}: states {size / 2**30:.1f} GiB; at most {MAX_BYTES >> 30} GiB are read")
    stored = int(dataset.id.get_storage_size())
    if size > LARGE_BYTES and size > MAX_RATIO * max(stored, 1):
        raise InvalidData(f"{place}: states {size} bytes but stores {stored}; not a measurement")
    array: npt.NDArray[np.generic] = dataset[()]
    return array
