"""What a file says that it is in its first bytes: nothing is parsed for it."""

from pathlib import Path

from nlos.acquisition.recording.header import FORMAT

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_HEAD_BYTES = 8 << 20


def is_recording(path: Path) -> bool:
    """Whether `path` says that it is a recording of our own. Told by its bytes: HDF5 itself may not return from a
    damaged file, and this is asked of every file."""
    if magic_of(path) != HDF5_MAGIC:
        return False
    with path.open("rb") as file:
        return FORMAT.encode("ascii") in file.read(_HEAD_BYTES)


def magic_of(path: Path) -> bytes:
    """The first 8 bytes. Raises `FileNotFoundError`."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    with path.open("rb") as file:
        return file.read(8)
