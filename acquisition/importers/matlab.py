"""MATLAB scans (v5 and v7.3): O'Toole 2018, Lindell 2019 with tofgrid, LFE's measurements and NLOST's USTC scans.

Keys and constants: O'Toole, Lindell, Wetzstein, Nature 2018 (`rect_data`, `width`); Lindell, Wetzstein, O'Toole,
ACM TOG 2019 (`meas`, `tofgrid`); Chen et al., ACM TOG 2020 (`measlr`); Li et al., CVPR 2023 (`data`, `final_meas`).
"""

import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.arrays import (
    KNOWN,
    MOST_NAMED,
    StoredArrays,
    scan_of,
    without_missing,
    without_single_axes,
)
from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.imported import NO_WALL, ImportedScan, assumed_sides_m
from nlos.acquisition.importers.magic import is_hdf5
from nlos.acquisition.importers.mat5_types import no_number
from nlos.acquisition.importers.own_data import how_to_convert
from nlos.acquisition.importers.untrusted_hdf5 import MAX_BYTES, find_dataset, open_hdf5, read_array
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid

Array = npt.NDArray[np.generic]


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
_OF_LAYOUTS = ("width", "tofgrid", "pos", "bin_resolution", "wall_size")
"""What the published files, and the scripts that came with them, call what goes with the counts: seconds, metres."""
_A_FACT = re.compile(
    r"delta|^d?t$|^d[xyzt]_|^ts?$|^t_?0$|time|bin|resol|_p?s$|width|height|wall|size|spac|pitch|pos|grid|coord|laser|"
    r"sensor|camera|spad|origin|speed|^c0?$|^[xyz]_?|axes|order",
    re.IGNORECASE,
)
"""Names that may speak of time, places or order, in units that nobody here knows."""


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
    if layout.key != "rect_data" and "bin_width_s" in shapes:
        return _read_own(path, shapes, given, layout.key)
    _refuse_unknown_facts(path, shapes, layout, given)
    counts = without_single_axes(_read(path, layout.key, shapes))
    if counts.ndim != 3:
        raise InvalidData(f"{path}: {layout.key}: has shape {counts.shape}; two wall axes and time are expected")
    counts = given.ordered(counts, f"{path}: {layout.key}")
    if layout.x_first:
        counts = (counts.transpose(1, 0, 2) if given.axes is None else counts)[:, ::-1]
    rows, cols, bins = counts.shape
    notes = ["exposure is not stored; assuming 1 s per point"]
    counts, exposure_s = without_missing(counts, np.ones((rows, cols)), notes)
    longer_m, width_s = _told_side_m(path, shapes), _told_bin_width_s(path, shapes)
    sides_m = assumed_sides_m(rows, cols, longer_m or layout.wall_m)
    square = "" if rows == cols else ", points as far apart in x as in y"
    if longer_m is None:
        notes.append(f"{NO_WALL}; assuming {layout.wall_m:g} m, this format's own{square}")
    elif square:
        notes.append(f"assuming a wall of {sides_m[0]:.4g} x {sides_m[1]:.4g} m{square}")
    if width_s is None and given.bin_width_s is None:
        notes.append(f"the bin width is not stored; assuming {layout.bin_width_s * 1e12:g} ps, this format's own")
    if layout.falloff is None:
        notes.append("diffuse or retroreflective is not stored; assuming diffuse (--set falloff=2 for the other)")
    if others := sorted(shapes.keys() - {layout.key, *_OF_LAYOUTS} | shapes.keys() & {"pos"}):
        notes.append(f"not used: {', '.join(others[:MOST_NAMED])}")
    time = TimeAxis(bins, width_s or layout.bin_width_s)
    offsets = (
        _time_of_flight(path, (rows, cols), given.bin_width_s or time.bin_width_s) if layout.key == "meas" else None
    )
    transient = Transient(
        np.ascontiguousarray(np.moveaxis(counts, 2, 0), dtype=np.float32),
        exposure_s,
        WallGrid(*sides_m, rows, cols),
        time,
    )
    return ImportedScan(
        transient,
        layout.name,
        falloff=layout.falloff,
        rectified=offsets is None,
        time_offset_bins=offsets,
        notes=tuple(notes),
    )


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


def _read_own(path: Path, shapes: dict[str, tuple[int, ...]], given: Given, place: str = "histograms") -> ImportedScan:
    """A file of our own exporter, or anybody's with the same names."""
    beside = {name: _read(path, name, shapes) for name in KNOWN if name in shapes}
    others = tuple(name for name in shapes if name not in (place, *KNOWN))
    counts = _read(path, place, shapes)
    return scan_of(StoredArrays(str(path), "MATLAB export", place, counts, beside, others), given)


def _refuse_unknown_facts(path: Path, shapes: dict[str, tuple[int, ...]], layout: _Layout, given: Given) -> None:
    """Raises `InvalidData` for counts in a published format's name beside names which that format has not and which may
    say another bin width, wall or order: the format's own would be another lab's."""
    unknown = sorted(name for name in shapes if name not in (layout.key, *_OF_LAYOUTS) and not name.startswith("tof"))
    facts = [name for name in unknown if _A_FACT.search(name)]
    if not facts or (given.bin_width_s is not None and given.wall_m is not None):
        return
    raise InvalidData(
        f"{path}: {layout.key}: is what {layout.name} calls its counts, of {layout.bin_width_s * 1e12:g} ps bins on a wall "
        f"of {layout.wall_m:g} m, but {', '.join(facts[:MOST_NAMED])} beside them may say otherwise. Say what holds: "
        f"--bin-width-ps and --wall-size-m (and --axes, --raw where they are needed). {how_to_convert()}"
    )


def _told_side_m(path: Path, shapes: dict[str, tuple[int, ...]]) -> float | None:
    """The longer side of the wall, by its half (`width`, O'Toole) or whole (`wall_size`, Lindell); None where neither is
    there. Raises `InvalidData`."""
    for name, times, what in (("width", 2.0, "half the wall's side"), ("wall_size", 1.0, "the wall's side")):
        if name in shapes:
            side_m = np.asarray(_read(path, name, shapes), dtype=np.float64).ravel()
            if not 1 <= side_m.size <= 2 or not (0 < side_m).all() or not (side_m < 100).all() or np.ptp(side_m):
                raise InvalidData(f"{path}: {name}: {what} in metres is expected (found {side_m[:3]})")
            return times * float(side_m[0])
    return None


def _told_bin_width_s(path: Path, shapes: dict[str, tuple[int, ...]]) -> float | None:
    """`bin_resolution`, as the scripts of both groups call it; None where it is not there. Raises `InvalidData`."""
    if "bin_resolution" not in shapes:
        return None
    width_s = np.asarray(_read(path, "bin_resolution", shapes), dtype=np.float64).ravel()
    if width_s.size != 1 or not 1e-13 <= width_s[0] <= 1e-8:
        raise InvalidData(f"{path}: bin_resolution: seconds are expected (found {width_s[:3]}). Use --bin-width-ps PS")
    return float(width_s[0])


def _time_of_flight(path: Path, grid: tuple[int, int], bin_width_s: float) -> npt.NDArray[np.float64] | None:
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
        return picoseconds * 1e-12 / bin_width_s
    return None


def _structs(path: Path) -> list[str]:
    """Structs of a file of version 7.3, each with the names in it: no scan is looked for there."""
    if not is_hdf5(path):
        return []
    with open_hdf5(path) as file:
        here = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
        groups = {name: file[name] for name in here if isinstance(file[name], h5py.Group) and not name.startswith("#")}
        return [f"{name} (a struct: {', '.join(list(each)[:MOST_NAMED])})" for name, each in groups.items()]


def _shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Names and shapes (MATLAB's axis order) of the numeric variables, from the headers alone."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    if is_hdf5(path):
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
    if is_hdf5(path):
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
