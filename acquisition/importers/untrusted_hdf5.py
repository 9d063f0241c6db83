"""HDF5 files from outside: opened without following links, read without trusting the sizes that they state."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording.disk_refusal import disk_refusal
from nlos.acquisition.recording.no_such_file import no_such_file
from nlos.acquisition.recording.writer_lock import has_no_locks

MAX_BYTES = 8 << 30
"""Largest array read, as float32: a 1024 x 1024 x 2048 scan."""
LARGE_BYTES = 256 << 20
MAX_RATIO = 2000
"""Above `LARGE_BYTES`, more than this many bytes out of one stored byte is a decompression bomb, not a measurement."""


@contextmanager
def open_hdf5(path: Path) -> Iterator[h5py.File]:
    """The file, read-only. Raises `InvalidData` where it is not HDF5, also while reading inside the block, and
    `StorageError` where the disk does not give it."""
    if not path.is_file():
        raise no_such_file(path)
    try:
        with read_only(path) as file:
            yield file
    except (OSError, RuntimeError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        damage = InvalidData(f"{path}: not a readable HDF5 file. Is the copy complete?")
        raise disk_refusal(path, error) or damage from error


def read_only(path: Path) -> h5py.File:
    """The file, opened read-only, also where its file system has no locks. Raises what h5py raises."""
    try:
        return h5py.File(path, "r", locking="best-effort")
    except OSError as error:
        if not has_no_locks(error):
            raise
        return h5py.File(path, "r", locking=False)


def find_dataset(file: h5py.File, name: str) -> h5py.Dataset | None:
    """The dataset called `name` (`leaf` or `group/leaf`), None where there is none. Links out of the file are
    refused."""
    item: h5py.Group | h5py.Dataset = file
    for word in name.split("/"):
        if not isinstance(item, h5py.Group) or word not in item.keys():  # noqa: SIM118 - `in item` follows links
            return None
        if not isinstance(item.get(word, getlink=True), h5py.HardLink):
            raise InvalidData(f"{file.filename}: {name}: is a link to elsewhere; links are not followed")
        item = item[word]
    if not isinstance(item, h5py.Dataset):
        return None
    if item.is_virtual or item.external:
        raise InvalidData(f"{file.filename}: {name}: its data lie in other files; copy them into one file")
    return item


def needed_dataset(file: h5py.File, name: str) -> h5py.Dataset:
    """The dataset called `name`. Raises `InvalidData` where there is none, or it is empty."""
    dataset = find_dataset(file, name)
    if dataset is None or dataset.shape is None:
        raise InvalidData(f"{file.filename}: {name}: is missing or empty")
    return dataset


def needed_number(file: h5py.File, name: str) -> float:
    """The one number at `name`. Raises `InvalidData`."""
    dataset = needed_dataset(file, name)
    if dataset.size != 1 or dataset.dtype.kind not in "uifb":
        raise InvalidData(f"{file.filename}: {name}: must be one number (found {dataset.dtype} {dataset.shape})")
    return float(np.asarray(dataset[()]).reshape(()))


def needed_array(file: h5py.File, name: str, shape: tuple[int | None, ...]) -> npt.NDArray[np.float32]:
    """The finite numbers at `name`; None in `shape` stands for any length. Raises `InvalidData`."""
    dataset = find_dataset(file, name)
    if dataset is None or dataset.shape is None:
        raise InvalidData(f"{file.filename}: {name}: is missing, or no array")
    array = read_array(dataset, len(shape))
    if any(wanted not in (None, found) for wanted, found in zip(shape, array.shape, strict=True)):
        raise InvalidData(f"{file.filename}: {name}: has shape {array.shape}; {shape} is expected")
    return array.astype(np.float32)


def read_everything(path: Path) -> None:
    """Reads every array of numbers at the top of a file: for a child that goes before others. Raises `InvalidData`."""
    with open_hdf5(path) as file:
        dict(file.attrs)
        for name in file:
            dataset = find_dataset(file, name)
            if dataset is not None and dataset.shape and dataset.dtype.kind in "uif":
                read_array(dataset, len(dataset.shape))


def read_array(dataset: h5py.Dataset, dimensions: int) -> npt.NDArray[np.generic]:
    """All of `dataset`, after its type, dimensions and size were checked. Raises `InvalidData`."""
    place = f"{dataset.file.filename}: {dataset.name.lstrip('/')}"
    if dataset.shape is None:
        raise InvalidData(f"{place}: is empty: it has a type and holds no value. Write the numbers themselves.")
    if dataset.dtype.kind not in "uifb":
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
    try:
        array: npt.NDArray[np.generic] = dataset[()]
    except OSError as error:
        if not (absent := _absent_filters(dataset)):
            raise
        raise InvalidData(
            f"{place}: is packed by {absent}, a filter that HDF5 here does not have. Where it has, such as where the "
            f"file was made: `{_repack(dataset.file)}`, or save it again with gzip."
        ) from error
    return array


def _repack(file: h5py.File) -> str:
    """The command that packs a file by gzip: PyTables has filters of its own, which h5repack does not know."""
    if "PYTABLES_FORMAT_VERSION" in file.attrs:
        return f"ptrepack --complib=zlib {file.filename}:/ NEW.h5:/"
    return f"h5repack -f GZIP=4 {file.filename} NEW.h5"


def _absent_filters(dataset: h5py.Dataset) -> str:
    """The filters that a dataset went through and this HDF5 lacks, by their names or numbers; empty where none is."""
    how = dataset.id.get_create_plist()
    filters = [how.get_filter(place) for place in range(how.get_nfilters())]
    return ", ".join(
        name.decode(errors="replace") or f"{n}" for n, _, _, name in filters if not h5py.h5z.filter_avail(n)
    )
