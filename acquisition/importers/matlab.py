"""MATLAB scans (v5 and v7.3): O'Toole 2018, Lindell 2019 with tofgrid, LFE's measurements and NLOST's USTC scans.

Keys and constants: O'Toole, Lindell, Wetzstein, Nature 2018 (`rect_data`, `width`); Lindell, Wetzstein, O'Toole,
ACM TOG 2019 (`meas`, `tofgrid`); Chen et al., ACM TOG 2020 (`measlr`); Li et al., CVPR 2023 (`data`, `final_meas`).
"""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.arrays import KNOWN, MOST_NAMED, StoredArrays, scan_of
from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.imported import NO_WALL, ImportedScan
from nlos.acquisition.importers.mat5_types import no_number
from nlos.acquisition.importers.own_data import how_to_convert
from nlos.acquisition.importers.untrusted_hdf5 import MAX_BYTES, find_dataset, open_hdf5, read_array
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid

Array = npt.NDArray[np.generic]
_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class _Layout:
    """How one group's files name and order their counts."""

    key: str
    name: str
    bin_width_s: float
    wall_m: float
    falloff: int | None
    x_first: bool
    """Whether the first axis runs along x (then the picture reads correctly after a transpose and a flip of x)."""


_LAYOUTS = (
    _Layout("rect_data", "O'Toole 2018 .mat", 4e-12, 0.7, None, True),
    _Layout("meas", "Lindell 2019 f-k .mat", 32e-12, 2.0, 4, False),
    _Layout("measlr", "LFE 2020 .mat", 32e-12, 2.0, 4, False),
    _Layout("final_meas", "NLOST repackaged f-k .mat", 32e-12, 2.0, 4, False),
    _Layout("data", "USTC / NLOST 2023 .mat", 32e-12, 2.0, 4, False),
)


def read_matlab(path: Path, given: Given = NOTHING) -> ImportedScan:
    """Reads a scan from a .mat file; a `tof.mat` beside an f-k measurement gives its time offsets.

    Raises `InvalidData` naming file, key and reason.
    """
    shapes = _shapes(path)
    if "histograms" in shapes:
        return _read_own(path, shapes, given)
    layout = next((layout for layout in _LAYOUTS if layout.key in shapes), None)
    if layout is None:
        known = ", ".join(layout.key for layout in _LAYOUTS)
        held = ", ".join([*shapes, *_structs(path)]) or "nothing"
        raise InvalidData(
            f"{path}: none of the known scans (histograms; {known}); the file holds {held}. {how_to_convert()}"
        )
    counts = _read(path, layout.key, shapes)
    if counts.ndim != 3:
        raise InvalidData(f"{path}: {layout.key}: has shape {counts.shape}; two wall axes and time are expected")
    notes = ["exposure is not stored; assuming 1 s per point"]
    wall_m = layout.wall_m
    if "width" in shapes:
        half = np.asarray(_read(path, "width", shapes), dtype=np.float64).ravel()
        if half.size != 1 or not 0 < half[0] < 100:
            raise InvalidData(f"{path}: width: half the wall's side in metres is expected (found {half[:3]})")
        wall_m = 2 * float(half[0])
    else:
        notes.append(f"{NO_WALL}; assuming {wall_m:g} m, this format's own")
    if layout.falloff is None:
        notes.append("diffuse or retroreflective is not stored; assuming diffuse (--set falloff=2 for the other)")
    if layout.x_first:
        counts = counts.transpose(1, 0, 2)[:, ::-1]
    if others := sorted(shapes.keys() - {layout.key, "width", "tofgrid"}):
        notes.append(f"not used: {', '.join(others[:MOST_NAMED])}")
    rows, cols, bins = counts.shape
    offsets = _time_of_flight(path, (rows, cols), layout) if layout.key == "meas" else None
    transient = Transient(
        np.ascontiguousarray(np.moveaxis(counts, 2, 0), dtype=np.float32),
        np.ones((rows, cols)),
        WallGrid(wall_m, wall_m, rows, cols),
        TimeAxis(bins, layout.bin_width_s),
    )
    return ImportedScan(
        transient,
        layout.name,
        falloff=layout.falloff,
        rectified=offsets is None,
        time_offset_bins=offsets,
        notes=tuple(notes),
    )


def _read_own(path: Path, shapes: dict[str, tuple[int, ...]], given: Given) -> ImportedScan:
    """A file of our own exporter, or anybody's with the same names."""
    beside = {name: _read(path, name, shapes) for name in KNOWN if name in shapes}
    others = tuple(name for name in shapes if name not in ("histograms", *KNOWN))
    counts = _read(path, "histograms", shapes)
    return scan_of(StoredArrays(str(path), "MATLAB export", "histograms", counts, beside, others), given)


def _time_of_flight(path: Path, grid: tuple[int, int], layout: _Layout) -> npt.NDArray[np.float64] | None:
    """`tofgrid` (ps to each scan point) from the measurement itself or from `tof.mat` beside it, in bins."""
    for place in (path, path.with_name("tof.mat")):
        if not place.is_file():
            continue
        shapes = _shapes(place)
        if "tofgrid" not in shapes:
            continue
        picoseconds = np.asarray(_read(place, "tofgrid", shapes), dtype=np.float64)
        if picoseconds.shape != grid:
            raise InvalidData(f"{place}: tofgrid: has shape {picoseconds.shape}, the scan {grid}")
        return picoseconds * 1e-12 / layout.bin_width_s
    return None


def _is_hdf5(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(520)
    return head[:8] == _HDF5_MAGIC or head[512:520] == _HDF5_MAGIC


def _structs(path: Path) -> list[str]:
    """Structs of a file of version 7.3, each with the names in it: no scan is looked for there."""
    if not _is_hdf5(path):
        return []
    with open_hdf5(path) as file:
        here = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
        groups = {name: file[name] for name in here if isinstance(file[name], h5py.Group) and not name.startswith("#")}
        return [f"{name} (a struct: {', '.join(list(each)[:MOST_NAMED])})" for name, each in groups.items()]


def _shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Names and shapes (MATLAB's axis order) of the numeric variables, from the headers alone."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    if _is_hdf5(path):
        with open_hdf5(path) as file:
            found = {name: find_dataset(file, name) for name in file}
            return {name: tuple(reversed(item.shape)) for name, item in found.items() if item is not None}
    try:
        return {name: tuple(int(n) for n in shape) for name, shape, _ in scipy.io.whosmat(str(path))}
    except (scipy.io.matlab.MatReadError, *_BROKEN) as error:
        raise InvalidData(f"{path}: not a readable MATLAB file ({error or type(error).__name__})") from error


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


def _read(path: Path, key: str, shapes: dict[str, tuple[int, ...]]) -> Array:
    """One variable in MATLAB's axis order, its size checked before anything is allocated."""
    if _is_hdf5(path):
        with open_hdf5(path) as file:
            dataset = find_dataset(file, key)
            if dataset is None:
                raise InvalidData(f"{path}: {key}: is not an array")
            return read_array(dataset, len(dataset.shape)).T
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
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "uifb" or array.size == 0:
        raise InvalidData(f"{path}: {key}: is not an array of numbers")
    return array
