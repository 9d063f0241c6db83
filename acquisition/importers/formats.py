"""Which format a file is in, told by its contents, and the importer that reads it."""

from collections.abc import Callable
from pathlib import Path

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.matlab import read_matlab
from nlos.acquisition.importers.npz import read_npz
from nlos.acquisition.importers.picoquant import SUFFIXES as PICOQUANT_SUFFIXES
from nlos.acquisition.importers.picoquant import read_picoquant
from nlos.acquisition.importers.plain import read_plain
from nlos.acquisition.importers.untrusted_hdf5 import open_hdf5
from nlos.acquisition.importers.ytal import read_ytal, read_zaragoza
from nlos.acquisition.recording.header import FORMAT

_HEAD_BYTES = 8 << 20
_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
Reader = Callable[[Path], ImportedScan]


def is_recording(path: Path) -> bool:
    """Whether `path` says that it is a recording of our own. Told by its bytes: HDF5 itself may not return from a
    damaged file, and this is asked of every file."""
    if _magic(path) != _HDF5_MAGIC:
        return False
    with path.open("rb") as file:
        return FORMAT.encode("ascii") in file.read(_HEAD_BYTES)


def reader_of(path: Path) -> Reader:
    """The importer for a file. Raises `InvalidData` where none knows its contents."""
    suffix, magic = path.suffix.lower(), _magic(path)
    if suffix == ".mat":
        return read_matlab
    if suffix == ".npz":
        return read_npz
    if suffix in PICOQUANT_SUFFIXES or magic[:6] == b"PQTTTR":
        return read_picoquant
    if magic == _HDF5_MAGIC:
        with open_hdf5(path) as file:
            names = set(file.keys())
        if {"H", "H_format"} <= names:
            return read_ytal
        if {"data", "cameraGridPositions"} <= names:
            return read_zaragoza
        return read_plain
    raise InvalidData(
        f"{path}: in no format that is read here (HDF5, MAT, NPZ, PTU, PT3, HT3, T3R, PHD, HHD). Its name ends in "
        f"'{suffix}' and it begins with {magic!r}."
    )


def read_any(path: Path) -> ImportedScan:
    """Reads a scan in any known foreign format. Raises `InvalidData` naming file, place and reason."""
    return reader_of(path)(path)


def _magic(path: Path) -> bytes:
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    with path.open("rb") as file:
        return file.read(8)
