"""MATLAB scans (v5 and v7.3): O'Toole 2018, Lindell 2019 with tofgrid, LFE's measurements and NLOST's USTC scans.

Keys and constants: O'Toole, Lindell, Wetzstein, Nature 2018 (`rect_data`, `width`); Lindell, Wetzstein, O'Toole,
ACM TOG 2019 (`meas`, `tofgrid`); Chen et al., ACM TOG 2020 (`measlr`); Li et al., CVPR 2023 (`data`, `final_meas`).
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.arrays import (
    KNOWN,
    MOST_NAMED,
    StoredArrays,
    scan_of,
)
from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.imported import DOUBT, NO_WALL, ImportedScan, assumed_sides_m
from nlos.acquisition.importers.mat_file import read_variable, shapes_of, structs_of
from nlos.acquisition.importers.missing_direct import SAID, direct_is_missing
from nlos.acquisition.importers.own_data import how_to_convert
from nlos.acquisition.importers.separate_points import refuse_other_names
from nlos.acquisition.importers.stored_counts import without_missing, without_single_axes
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient, as_floats
from nlos.acquisition.wall import WallGrid


@dataclass(frozen=True)
class _Layout:
    """How one group's files name and order their counts."""

    key: str
    name: str
    bin_width_s: float
    wall_m: float
    falloff: int
    x_first: bool
    """Whether the first axis runs along x (then the picture reads correctly after a transpose and a flip of x)."""
    points: tuple[int, ...]
    """Rows, and as many columns, of the published scans ..."""
    bins: tuple[int, ...]
    """... and their time bins: counts of another shape are somebody else's, of other bins on another wall."""

    def published(self, shape: tuple[int, ...]) -> bool:
        """Whether the group's own scans are of that shape, or these with points or bins put together."""
        return len(shape) == 3 and shape[0] == shape[1] and shape[0] in self.points and shape[2] in self.bins


_LAYOUTS = (
    _Layout("rect_data", "O'Toole 2018 .mat", 4e-12, 0.7, 2, True, (64, 32), (2048, 4096)),
    _Layout("meas", "Lindell 2019 f-k .mat", 32e-12, 2.0, 4, False, (512, 256, 128, 64), (2048, 512)),
    _Layout("measlr", "LFE 2020 .mat", 32e-12, 2.0, 4, False, (256, 128, 64), (512,)),
    _Layout("final_meas", "NLOST repackaged f-k .mat", 32e-12, 2.0, 4, False, (256, 128, 64), (512,)),
    _Layout("data", "USTC / NLOST 2023 .mat", 32e-12, 2.0, 4, False, (128, 256), (512,)),
)
_H_AND_W = str.maketrans("HW", "YX")
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
    shapes = shapes_of(path)
    if "histograms" in shapes:
        return _read_own(path, shapes, given)
    layout = next((layout for layout in _LAYOUTS if layout.key in shapes), None)
    if layout is None:
        known = ", ".join(layout.key for layout in _LAYOUTS)
        structs = structs_of(path)
        held = ", ".join([*(name for name in shapes if not any(each.startswith(f"{name} (") for each in structs)),
                          *structs]) or "nothing"  # fmt: skip
        raise InvalidData(
            f"{path}: none of the known scans (histograms; {known}); the file holds {held}. {how_to_convert()}"
        )
    if layout.key != "rect_data" and "bin_width_s" in shapes:
        return _read_own(path, shapes, given, layout.key)
    refuse_other_names(str(path), shapes)
    _refuse_unknown_facts(path, shapes, layout, given)
    longer_m, width_s = _told_side_m(path, shapes), _told_bin_width_s(path, shapes)
    _refuse_other_shapes(path, shapes, layout, (width_s or given.bin_width_s, longer_m or given.wall_m), given.axes)
    counts = without_single_axes(read_variable(path, layout.key, shapes))
    if counts.ndim != 3:
        frames = (
            "" if counts.ndim < 4 else f". Several frames? Save one: {layout.key} = squeeze({layout.key}(1, :, :, :))"
        )
        raise InvalidData(
            f"{path}: {layout.key}: has shape {counts.shape}; two wall axes and time are expected{frames}"
        )
    counts = given.ordered(counts, f"{path}: {layout.key}")
    x_first = given.axes is not None and given.axes.upper().translate(_H_AND_W) in ("XYT", "XTY", "TXY")
    notes = ["exposure is not stored; assuming 1 s per point"]
    if layout.x_first and given.axes is None:
        counts = counts.transpose(1, 0, 2)[:, ::-1]
        notes.append(f"x is its first axis and falls, as in {layout.name} files (--axes YXT, XYT: as it is stored)")
    rows, cols, bins = counts.shape
    counts, exposure_s = without_missing(counts, np.ones((rows, cols)), notes)
    sides_m = assumed_sides_m(rows, cols, longer_m or layout.wall_m)
    square = "" if rows == cols else ", points as far apart in x as in y"
    if longer_m is None:
        notes.append(f"{NO_WALL}; assuming {layout.wall_m:g} m, this format's own{square}")
    elif square:
        notes.append(f"assuming a wall of {sides_m[0]:.4g} x {sides_m[1]:.4g} m{square}")
    if width_s is None and given.bin_width_s is None:
        notes.append(f"the bin width is not stored; assuming {layout.bin_width_s * 1e12:g} ps, this format's own")
    if layout.falloff == 2:
        notes.append(
            "diffuse or retroreflective is not stored; assuming retroreflective, as this format's own script does for "
            "all scenes but one (diffuse: --set falloff=4)"
        )
    if others := sorted(shapes.keys() - {layout.key, *_OF_LAYOUTS} | shapes.keys() & {"pos"}):
        notes.append(f"not used: {', '.join(others[:MOST_NAMED])}")
    time = TimeAxis(bins, width_s or given.bin_width_s or layout.bin_width_s)
    offsets = None
    if layout.key == "meas":
        offsets = _time_of_flight(path, (rows, cols), TimeAxis(bins, given.bin_width_s or time.bin_width_s), x_first)
        if offsets is None and given.rectified is None:
            notes.append(_without_times(bins, layout))
        elif offsets is not None and (doubt := _too_short(offsets, time.bin_width_s, sides_m)):
            notes.append(doubt)
    cube = as_floats(np.moveaxis(counts, 2, 0))
    if only_offsets := offsets is not None and direct_is_missing(cube, offsets):
        notes.append(SAID)
    transient = Transient(
        cube,
        exposure_s,
        WallGrid(*sides_m, rows, cols),
        time,
    )
    return ImportedScan(
        transient,
        layout.name,
        falloff=layout.falloff,
        rectified=offsets is None,
        rectified_assumed=offsets is None and layout.key != "rect_data" and given.rectified is None,
        time_offset_bins=offsets,
        no_direct_light=only_offsets,
        notes=tuple(notes),
    )


def _read_own(path: Path, shapes: dict[str, tuple[int, ...]], given: Given, place: str = "histograms") -> ImportedScan:
    """A file of our own exporter, or anybody's with the same names."""
    beside = {name: read_variable(path, name, shapes, "uifbU") for name in KNOWN if name in shapes}
    others = tuple(name for name in shapes if name not in (place, *KNOWN))
    counts = read_variable(path, place, shapes)
    return scan_of(StoredArrays(str(path), "MATLAB export", place, counts, beside, others), given)


def _refuse_unknown_facts(path: Path, shapes: dict[str, tuple[int, ...]], layout: _Layout, given: Given) -> None:
    """Raises `InvalidData` for counts in a published format's name beside names which that format has not and which may
    say another bin width, wall or order: the format's own would be another lab's."""
    unknown = sorted(name for name in shapes if name not in (layout.key, *_OF_LAYOUTS) and not name.startswith("tof"))
    facts = [name for name in unknown if _A_FACT.search(name)]
    if not facts or (given.bin_width_s is not None and given.wall_m is not None):
        return
    raise InvalidData(
        f"{path}: {layout.key}: is what {layout.name} calls its counts, of {layout.bin_width_s * 1e12:g} ps bins on a "
        f"wall of {layout.wall_m:g} m, but {', '.join(facts[:MOST_NAMED])} beside them may say otherwise. Say what "
        f"holds: --bin-width-ps and --wall-size-m (and --axes, --raw where they are needed). {how_to_convert()}"
    )


def _refuse_other_shapes(
    path: Path, shapes: dict[str, tuple[int, ...]], layout: _Layout, told: tuple[object, object], axes: str | None
) -> None:
    """Raises `InvalidData` for counts in a published format's name, but of no shape that it has, where bin width and
    wall are not both `told`: the names are common ones, and the format's own bins and wall would be another lab's."""
    shape = shapes[layout.key]
    with_times = layout.key == "meas" and _tof_place(path, shapes) is not None
    if len(shape) != 3 or layout.published(shape) or with_times:
        return
    if None not in told:
        if layout.x_first and "width" not in shapes and axes is None:
            raise InvalidData(
                f"{path}: {layout.key}: is what {layout.name} calls its counts, in which x is the first axis and falls;"
                f" of these, {' x '.join(map(str, shape))}, nothing says so. Say the order: --axes YXT, or XYT."
            )
        return
    raise InvalidData(
        f"{path}: {layout.key}: is what {layout.name} calls its counts, but those are {layout.points[0]} x "
        f"{layout.points[0]} x {layout.bins[0]}, and these {' x '.join(map(str, shape))}: bins of "
        f"{layout.bin_width_s * 1e12:g} ps and a wall of {layout.wall_m:g} m may be another lab's. Say what holds: "
        f"--bin-width-ps and --wall-size-m (and --axes TYX, --raw where they are needed). {how_to_convert()}"
    )


def _told_side_m(path: Path, shapes: dict[str, tuple[int, ...]]) -> float | None:
    """The longer side of the wall, by its half (`width`, O'Toole) or whole (`wall_size`, Lindell); None where
    neither is there. Raises `InvalidData`."""
    for name, times, what in (("width", 2.0, "half the wall's side"), ("wall_size", 1.0, "the wall's side")):
        if name in shapes:
            side_m = np.asarray(read_variable(path, name, shapes), dtype=np.float64).ravel()
            if not 1 <= side_m.size <= 2 or not (side_m > 0).all() or not (side_m < 100).all() or np.ptp(side_m):
                raise InvalidData(f"{path}: {name}: {what} in metres is expected (found {side_m[:3]})")
            return times * float(side_m[0])
    return None


def _told_bin_width_s(path: Path, shapes: dict[str, tuple[int, ...]]) -> float | None:
    """`bin_resolution`, as the scripts of both groups call it; None where it is not there. Raises `InvalidData`."""
    if "bin_resolution" not in shapes:
        return None
    width_s = np.asarray(read_variable(path, "bin_resolution", shapes), dtype=np.float64).ravel()
    if width_s.size != 1 or not 1e-13 <= width_s[0] <= 1e-8:
        raise InvalidData(f"{path}: bin_resolution: seconds are expected (found {width_s[:3]}). Use --bin-width-ps PS")
    return float(width_s[0])


def _without_times(bins: int, layout: _Layout) -> str:
    """What to say of counts that nothing says when light reached the wall of."""
    if bins != layout.bins[0]:
        return "no tofgrid in it, nor in a tof.mat beside it: taken as rectified (if it is not: --raw)"
    return (
        f"{DOUBT} no tofgrid in it, nor in a tof.mat beside it, and {bins} bins, as raw measurements of this kind have "
        f"(rectified ones: {', '.join(map(str, layout.bins[1:]))}); direct light would be taken for hidden surfaces. "
        "If it is raw: --raw, or put its tof.mat beside it. If time 0 is the wall: --rectified."
    )


def _too_short(offsets: npt.NDArray[np.float64], bin_width_s: float, sides_m: tuple[float, float]) -> str:
    """What to ask about times in which light cannot be at the farthest point of a wall and back, even from its middle;
    the electronics' own delay may take some off."""
    longest_s, least_s = (
        float(np.nanmax(offsets, initial=0)) * bin_width_s,
        float(np.hypot(*sides_m)) / SPEED_OF_LIGHT_M_PER_S,
    )
    if not 0 < longest_s < least_s / 4:
        return ""
    return (
        f"{DOUBT} tofgrid says at most {longest_s * 1e12:,.0f} ps; to a corner of a wall of {sides_m[0]:.4g} x "
        f"{sides_m[1]:.4g} m and back light takes {least_s * 1e12:,.0f} ps or more. Is it in bins? Store picoseconds."
    )


def _time_of_flight(path: Path, grid: tuple[int, int], time: TimeAxis, x_first: bool) -> npt.NDArray[np.float64] | None:
    """`tofgrid` (ps to each scan point) from the measurement itself or from `tof.mat` beside it, in bins; `x_first`
    where its rows run along x. Raises `InvalidData` for times that no unit but picoseconds can have made."""
    place = _tof_place(path, shapes_of(path))
    if place is None:
        return None
    picoseconds = np.asarray(read_variable(place, "tofgrid", shapes_of(place)), dtype=np.float64)
    picoseconds = picoseconds.T if x_first else picoseconds
    if picoseconds.shape != grid:
        raise InvalidData(f"{place}: tofgrid: has shape {picoseconds.shape}, the scan {grid}")
    offsets = picoseconds * 1e-12 / time.bin_width_s
    sizes = np.abs(offsets[np.isfinite(offsets)])
    if sizes.size and (0 < sizes.max() < 1 or sizes.min() >= time.bins):
        within = "below one bin" if sizes.max() < 1 else f"beyond all {time.bins} bins"
        raise InvalidData(
            f"{place}: tofgrid: is {np.nanmin(picoseconds):.4g} to {np.nanmax(picoseconds):.4g}: as picoseconds, "
            f"{within} of {time.bin_width_s * 1e12:g} ps at every point. Picoseconds to each point and back are "
            "expected, 6,671 for a metre: are these seconds, nanoseconds or metres?"
        )
    return offsets


def _tof_place(path: Path, shapes: dict[str, tuple[int, ...]]) -> Path | None:
    """The file that holds `tofgrid`: the measurement itself, or `tof.mat` beside it; None where neither does."""
    beside = path.with_name("tof.mat")
    if "tofgrid" in shapes:
        return path
    return beside if beside.is_file() and "tofgrid" in shapes_of(beside) else None
