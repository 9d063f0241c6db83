"""Which format a file is in, told by its contents, and the importer that reads it."""

from collections.abc import Callable
from pathlib import Path

import h5py

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.becker_hickl import is_sdt, read_sdt
from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.magic import begins_with, is_hdf5, magic_of, read_bytes
from nlos.acquisition.importers.mat_file import by_matlab
from nlos.acquisition.importers.matlab import read_matlab
from nlos.acquisition.importers.npz import is_npz, read_npy, read_npz
from nlos.acquisition.importers.own_data import how_to_convert, of_octave
from nlos.acquisition.importers.photon_hdf5 import is_photon_hdf5, read_photon_hdf5
from nlos.acquisition.importers.picoquant import KNOWN as PICOQUANT
from nlos.acquisition.importers.picoquant import MAGIC as PICOQUANT_MAGIC
from nlos.acquisition.importers.picoquant import SUFFIXES as PICOQUANT_SUFFIXES
from nlos.acquisition.importers.picoquant import read_picoquant
from nlos.acquisition.importers.plain import read_plain
from nlos.acquisition.importers.untrusted_hdf5 import open_hdf5
from nlos.acquisition.importers.ytal import read_ytal, read_zaragoza

Reader = Callable[[Path, Given], ImportedScan]
KNOWN_FORMATS = f"HDF5, MAT, NPZ, NPY, {PICOQUANT}, SDT"
_PACKED = {
    b"PK\x03\x04": "ZIP", b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"(\xb5/\xfd": "Zstandard",
    b"7z\xbc\xaf": "7-Zip", b"Rar!": "RAR",
}  # fmt: skip

_WORKBOOKS = (".xlsx", ".xlsm", ".ods")
"""Packed by ZIP, and nothing inside is of use to anybody."""

_OCTAVE = (b"Octave-1", b"# Created by Octave ")
"""What `save -binary` and plain `save` begin a file with."""


def reader_of(path: Path) -> Reader:
    """The importer for a file. Raises `InvalidData` where none knows its contents."""
    suffix, magic = path.suffix.lower(), magic_of(path)
    if is_hdf5(path):
        return _reader_of_hdf5(path)
    if not magic:
        raise InvalidData(f"{path}: is empty, 0 bytes. Copy it again from where it was made.")
    if magic == b"version ":  # https://git-lfs.github.com/spec/v1
        raise InvalidData(f"{path}: is a pointer of Git LFS, not the file. Get that with `git lfs pull`.")
    if magic.startswith(PICOQUANT_MAGIC):
        return read_picoquant
    if is_sdt(path):
        return read_sdt
    if any(begins_with(path, head) for head in _OCTAVE):
        raise InvalidData(f"{path}: {of_octave()}")
    packed = next((name for head, name in _PACKED.items() if magic.startswith(head)), None)
    if (suffix == ".mat" and packed is None) or magic == b"MATLAB 5":
        return read_matlab
    if suffix == ".npz" or is_npz(path):
        return read_npz
    if suffix == ".npy" or magic[:6] == b"\x93NUMPY":
        return read_npy
    if packed is None and _is_tar(path):
        packed = "tar"
    if packed is not None and suffix not in _WORKBOOKS:
        raise InvalidData(f"{path}: is packed by {packed}. Unpack it, and name the file inside.")
    if suffix in PICOQUANT_SUFFIXES:
        return read_picoquant
    if suffix == ".sdt":
        return read_sdt
    if suffix == ".spc":
        raise InvalidData(
            f"{path}: is a FIFO stream of Becker & Hickl: photons, and nothing that says how a scan is put together. "
            "Name the SDT file that SPCM makes of it, or convert it to Photon-HDF5 (phconvert; it needs the .set, too)."
        )
    if suffix == ".ttbin":
        raise InvalidData(
            f"{path}: is a stream of Swabian's Time Tagger: clicks, and nothing that says which belong to a point. "
            "Replay it with the vendor's software (createTimeTaggerVirtual) into Flim or TimeDifferences by the "
            f"scan's marker, and save their counts. {how_to_convert()}"
        )
    raise InvalidData(
        f"{path}: in no format that is read here ({KNOWN_FORMATS}). Its name ends in "
        f"'{suffix}' and it begins with {magic!r}. {how_to_convert()}"
    )


def _is_tar(path: Path) -> bool:
    """Whether a file is a POSIX tar archive, which says so behind the first name in it."""
    with read_bytes(path) as file:
        file.seek(257)
        return file.read(5) == b"ustar"


def _reader_of_hdf5(path: Path) -> Reader:
    with open_hdf5(path) as file:
        names, photons = set(file.keys()), is_photon_hdf5(file)
        here = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
        if any("OCTAVE_NEW_FORMAT" in file[name].attrs for name in here):
            raise InvalidData(f"{path}: {of_octave()}")
    if photons:
        return read_photon_hdf5
    if {"H", "H_format"} <= names:
        return lambda path, given: read_ytal(path)
    if {"data", "cameraGridPositions"} <= names:
        return lambda path, given: read_zaragoza(path)
    if by_matlab(path):
        return read_matlab
    return lambda path, given: read_plain(path, given=given)


def read_any(path: Path, given: Given = NOTHING) -> ImportedScan:
    """Reads a scan in any known foreign format; what is `given` goes before what it says. Raises `InvalidData` naming
    file, place and reason, also for values that nobody can have measured."""
    scan = reader_of(path)(path, given)
    given.refuse_axes(str(path), scan)
    given.refuse_detector(str(path), scan)
    scan = given.applied(scan)
    scan.check(str(path))
    return scan
