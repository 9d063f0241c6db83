"""Variables of a MAT file of version 5 or 7.3: names, shapes and arrays, in MATLAB's order of axes."""

import struct
import zlib
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.arrays import KNOWN, MOST_NAMED
from nlos.acquisition.importers.magic import is_hdf5
from nlos.acquisition.importers.mat5_types import no_number
from nlos.acquisition.importers.untrusted_hdf5 import MAX_BYTES, find_dataset, open_hdf5, read_array

Array = npt.NDArray[np.generic]


def by_matlab(path: Path) -> bool:
    """Whether MATLAB, or a library that writes as it does, wrote an HDF5 file, whatever it is called: its arrays have
    their axes in reverse order. A name in .mat says it as well, unless facts are attributes, which MATLAB has not."""
    with path.open("rb") as stored:
        if stored.read(6) == b"MATLAB":
            return True
    with open_hdf5(path) as file:
        arrays = [held for name in file if (held := _own_dataset(file, name)) is not None]
        if any("MATLAB_class" in held.attrs for held in arrays):
            return True
        said = any(name in held.attrs for held in (file, *arrays) for name in KNOWN)
    return path.suffix.lower() == ".mat" and not said


def _own_dataset(file: h5py.File, name: str) -> h5py.Dataset | None:
    """A dataset that lies in the file itself, and holds something."""
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        return None
    held = file[name]
    return held if isinstance(held, h5py.Dataset) and held.shape is not None else None


def structs_of(path: Path) -> list[str]:
    """Structs (of version 7.3 with the names in them), cells and sparse arrays: no scan is looked for there."""
    if not is_hdf5(path):
        return [f"{name} (a {kind})" for name, _, kind in scipy.io.whosmat(str(path)) if kind in _NO_NUMBERS]
    with open_hdf5(path) as file:
        here = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
        groups = {name: file[name] for name in here if isinstance(file[name], h5py.Group) and not name.startswith("#")}
        cells = [f"{name} (a cell)" for name in here if isinstance(file[name], h5py.Dataset) and _is_cell(file[name])]
        return cells + [
            f"{name} (sparse: save full({name}))"
            if "MATLAB_sparse" in each.attrs
            else f"{name} (a struct: {', '.join(list(each)[:MOST_NAMED])})"
            for name, each in groups.items()
        ]


def _is_cell(dataset: h5py.Dataset) -> bool:
    """Whether an array of version 7.3 is one of references, as MATLAB stores a cell."""
    return h5py.check_ref_dtype(dataset.dtype) is not None


def shapes_of(path: Path) -> dict[str, tuple[int, ...]]:
    """Names and shapes (MATLAB's axis order) of the numeric variables, from the headers alone."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    if is_hdf5(path):
        with open_hdf5(path) as file:
            found = {name: find_dataset(file, name) for name in file}
            held = {name: item for name, item in found.items() if item is not None}
            return {name: (0, 0) if item.shape is None else item.shape[::-1] for name, item in held.items()}
    try:
        return {name: tuple(int(n) for n in shape) for name, shape, _ in scipy.io.whosmat(str(path))}
    except (scipy.io.matlab.MatReadError, *_BROKEN) as error:
        raise InvalidData(f"{path}: not a readable MATLAB file ({error or type(error).__name__})") from error


_NO_NUMBERS = ("struct", "cell", "sparse", "object", "function", "char")
_CELL = "is a cell array. Save the numbers in it, such as {}{{1}}"
_BROKEN = (
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    NameError,
    NotImplementedError,
    OSError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)
"""What scipy's reader raises on a damaged file, beside its own error."""


def read_variable(path: Path, key: str, shapes: dict[str, tuple[int, ...]], kinds: str = "uifb") -> Array:
    """One variable in MATLAB's axis order, its size checked before anything is allocated; `kinds` of NumPy's types."""
    if is_hdf5(path):
        with open_hdf5(path) as file:
            dataset = find_dataset(file, key)
            if dataset is None:
                raise InvalidData(f"{path}: {key}: is not an array")
            if dataset.attrs.get("MATLAB_empty"):  # what is stored then is its shape
                raise InvalidData(f"{path}: {key}: is empty")
            if _is_cell(dataset):
                raise InvalidData(f"{path}: {key}: {_CELL.format(key)}")
            return read_array(dataset, len(dataset.shape or ())).T
    size = int(np.prod([int(n) for n in shapes[key]], dtype=object)) * 8
    # zlib expands at most about 1032 times, so a header that promises more than that is a lie.
    if size > MAX_BYTES or size > 1100 * 8 * path.stat().st_size:
        raise InvalidData(f"{path}: {key}: states shape {shapes[key]}, which the file cannot hold")
    if (wrong := no_number(path, key)) is not None:
        raise InvalidData(f"{path}: {key}: cannot be read (its numbers are of type {wrong}, which there is not)")
    try:
        array = scipy.io.loadmat(str(path), variable_names=[key]).get(key)
    except (scipy.io.matlab.MatReadError, *_BROKEN) as error:
        raise InvalidData(f"{path}: {key}: cannot be read ({error or type(error).__name__})") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in kinds or array.size == 0:
        raise InvalidData(f"{path}: {key}: {_instead_of_numbers(array, key)}")
    return array


def _instead_of_numbers(held: object, key: str) -> str:
    """What a variable of version 5 is that is no full array of real numbers, and what to do in MATLAB."""
    if scipy.sparse.issparse(held):
        return f"is sparse. Save full({key})"
    if not isinstance(held, np.ndarray):
        return "is not an array of numbers"
    if held.dtype.kind == "c":
        return f"is complex, and counts are not. Save real({key}), if that is what they are"
    if held.dtype.names:
        fields = ", ".join(held.dtype.names[:MOST_NAMED])
        return f"is a struct of {fields}. Save its fields: save(FILE, '-struct', '{key}')"
    if held.dtype.kind == "O":
        return _CELL.format(key)
    return "is empty" if held.size == 0 else "is text, not numbers"
