"""What a file says that it is in its first bytes: nothing is parsed for it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from nlos.acquisition.importers.own_data import how_to_convert
from nlos.acquisition.recording.disk_refusal import disk_refusal
from nlos.acquisition.recording.header import FORMAT
from nlos.acquisition.recording.no_such_file import meant_by, no_such_file

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_FIRST_BYTES, _HEAD_BYTES = 1 << 16, 8 << 20
_SUPERBLOCKS = (0, 512, 1024, 2048, 4096, 8192, 16384, 32768, 65536)
"""Where HDF5 may begin; further on nobody puts it."""
_OF_ZARR = ("zarr.json", ".zgroup", ".zarray")
"""A file that every Zarr store has, of version 3 and 2."""


def is_recording(path: Path) -> bool:
    """Whether `path` says that it is a recording of our own. Told by its bytes: HDF5 itself may not return from a
    damaged file, and this is asked of every file."""
    check_is_file(path)
    word = FORMAT.encode("ascii")
    with read_bytes(path) as file:
        if not _go_to_hdf5(file):
            return False
        head = file.read(_FIRST_BYTES)  # where ours have it; a damaged file is read on
        return word in head or word in head[-len(word) :] + file.read(_HEAD_BYTES - _FIRST_BYTES)


def is_hdf5(path: Path) -> bool:
    """Whether a file says that it is HDF5."""
    check_is_file(path)
    with read_bytes(path) as file:
        return _go_to_hdf5(file)


def _go_to_hdf5(file: BinaryIO) -> bool:
    """Goes to where HDF5 begins, also behind a block of the user's own, as MATLAB and `h5jam` write it; whether it
    does."""
    for at in _SUPERBLOCKS:
        file.seek(at)
        if file.read(len(HDF5_MAGIC)) == HDF5_MAGIC:
            file.seek(at)
            return True
    return False


def magic_of(path: Path) -> bytes:
    """The first 8 bytes. Raises as `check_is_file`."""
    check_is_file(path)
    with read_bytes(path) as file:
        return file.read(8)


def begins_with(path: Path, head: bytes) -> bool:
    """Whether these are the file's first bytes."""
    with read_bytes(path) as file:
        return file.read(len(head)) == head


@contextmanager
def read_bytes(path: Path) -> Iterator[BinaryIO]:
    """The file, opened for its bytes. Raises `StorageError` where the disk does not give them."""
    try:
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise disk_refusal(path, error) or error from error


def check_is_file(path: Path) -> None:
    """Raises `FileNotFoundError`, or `IsADirectoryError` for a folder."""
    if path.is_dir():
        if any((path / name).is_file() for name in _OF_ZARR):
            raise IsADirectoryError(f"{path}: is a Zarr store, which is not read here. {how_to_convert()}")
        meant = meant_by(path) or f"Name a file in it. One histogram a file? {how_to_convert()}"
        raise IsADirectoryError(f"{path}: is a folder. {meant}")
    if not path.is_file():
        raise no_such_file(path)
