"""NPZ scans, as NumPy and `nlos export --to npz` write them: see `arrays` for the names."""

import zipfile
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.arrays import KNOWN, StoredArrays, scan_of
from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.own_data import how_to_convert, of_objects
from nlos.acquisition.importers.untrusted_hdf5 import MAX_BYTES

_MAX_RATIO = 1100  # zlib's own limit is about 1032


def read_npz(path: Path, given: Given = NOTHING) -> ImportedScan:
    """Reads a scan. Raises `InvalidData` naming file, place and reason."""
    arrays, others = _arrays(path)
    counts = arrays.pop("histograms", None)
    if counts is None:
        held = ", ".join(sorted((*arrays, *others))) or "nothing"
        raise InvalidData(f"{path}: no array 'histograms'; the file holds {held}. {how_to_convert()}")
    if counts.dtype.kind not in "uifb" or counts.size == 0:
        raise InvalidData(f"{path}: histograms: holds {counts.dtype} {counts.shape}, not real numbers")
    return scan_of(StoredArrays(str(path), "NPZ", "histograms", counts, arrays, others), given)


def is_npz(path: Path) -> bool:
    """Whether a file, whatever it is called, is an archive of NumPy's arrays."""
    with path.open("rb") as file:
        if file.read(4) != b"PK\x03\x04":
            return False
    try:
        with zipfile.ZipFile(path) as archive:
            return bool(names := archive.namelist()) and all(name.endswith(".npy") for name in names)
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return False


def read_npy(path: Path, given: Given = NOTHING) -> ImportedScan:
    """Reads an array alone, as `numpy.save` writes it: the user says its bin width and wall. Raises `InvalidData`."""
    if path.stat().st_size > MAX_BYTES:
        raise InvalidData(f"{path}: is {path.stat().st_size / 2**30:.1f} GiB; at most {MAX_BYTES >> 30} GiB are read")
    try:
        counts = np.load(path, allow_pickle=False, mmap_mode="r")
    except (ValueError, EOFError, OSError, SyntaxError, TypeError, OverflowError, MemoryError, RuntimeError) as error:
        if _of_objects(error):
            raise InvalidData(f"{path}: {of_objects()}") from error
        raise InvalidData(f"{path}: not a readable NPY file ({type(error).__name__}: {error})") from error
    if not isinstance(counts, np.ndarray) or counts.dtype.kind not in "uifb" or counts.size == 0:
        raise InvalidData(f"{path}: holds no array of numbers. {how_to_convert()}")
    return scan_of(StoredArrays(str(path), "NumPy array", path.name, np.asarray(counts), {}), given)


def _of_objects(error: Exception) -> bool:
    """Whether NumPy refused an array since it would have to be unpickled."""
    return isinstance(error, ValueError) and any(word in str(error) for word in ("pickle", "objects in dtype"))


def _arrays(path: Path) -> tuple[dict[str, npt.NDArray[np.generic]], tuple[str, ...]]:
    """The arrays that mean something, and the names of the others, which are not read."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
        total = sum(member.file_size for member in members)
        if len(members) > 64 or total > MAX_BYTES or total > _MAX_RATIO * max(path.stat().st_size, 1):
            raise InvalidData(f"{path}: states {len(members)} arrays of {total} bytes, which it cannot hold")
        with np.load(path, allow_pickle=False) as stored:
            wanted = ("histograms", *KNOWN)
            others = tuple(name for name in stored.files if name not in wanted)
            return {name: np.asarray(stored[name]) for name in wanted if name in stored.files}, others
    except (ValueError, zipfile.BadZipFile, zlib.error, EOFError, OSError, KeyError, NotImplementedError,
            RuntimeError, SyntaxError, MemoryError, TypeError, OverflowError) as error:  # fmt: skip
        if isinstance(error, InvalidData):
            raise
        if _of_objects(error):
            raise InvalidData(f"{path}: {of_objects()}") from error
        raise InvalidData(f"{path}: not a readable NPZ file ({type(error).__name__}: {error})") from error
