"""Histograms and what lies beside them as a scan: the one layout of plain HDF5, NPZ and MAT, and of what `nlos export`
writes. `docs/howto/my-data.md` lists the names; whatever else a file holds is named and not used."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.given import Given, put_there
from nlos.acquisition.importers.grid_places import on_even_grid, refuse_turned_grid
from nlos.acquisition.importers.imported import ASSUMED, NO_WALL, FreePoints, ImportedScan, assumed_sides_m
from nlos.acquisition.importers.separate_points import POINTS, at_midpoints_of, has_points, refuse_other_names
from nlos.acquisition.importers.stored_counts import without_missing, without_single_axes
from nlos.acquisition.response import Response, stated
from nlos.acquisition.transient import TimeAxis, Transient, as_floats
from nlos.acquisition.wall import WallGrid, about_their_middle, grid_around

Array = npt.NDArray[Any]
KNOWN = (
    "bin_width_s", "wall_size_m", "wall_size_assumed", "offset_s", "x_m", "y_m", "exposure_s", "rectified",
    "direct_cut_bins", "falloff_exponent_authors", "time_offset_bins", "response", "response_bin_width_s",
    "response_fwhm_ps", "samples_left_aside", *POINTS,
)  # fmt: skip
"""Names that have a meaning beside the histograms."""
_ONE = ("x_m", "y_m", "response")
"""Of one dimension, whatever the format makes of it."""
NOT_SAID = (
    "`rectified` is not stored; assuming that it is: time 0 is the wall point, direct light is gone (if not: --raw)"
)
MOST_NAMED = 24


@dataclass(frozen=True)
class StoredArrays:
    """What a file holds, in its own order."""

    name: str
    """Of the file."""
    format: str
    place: str
    """Of the histograms within it."""
    counts: Array
    beside: Mapping[str, Array]
    """By `KNOWN` names; single values are arrays of one."""
    others: tuple[str, ...] = ()
    """Names that mean nothing here."""
    falloff: int | None = None
    """Where the file states none."""


def scan_of(stored: StoredArrays, given: Given) -> ImportedScan:
    """The scan; what is `given` goes before what is stored. Raises `InvalidData` naming file, place and reason."""
    refuse_other_names(stored.name, (*stored.beside, *stored.others))
    counts = without_single_axes(stored.counts)
    if counts.ndim not in (2, 3):
        raise InvalidData(
            f"{stored.name}: {stored.place}: has {counts.ndim} dimensions {counts.shape}; 3 dimensions [H, W, T] are "
            "expected, or [N, T] with x_m and y_m [N]"
        )
    width_s = given.bin_width_s or _number(stored, "bin_width_s", option="--bin-width-ps PS")
    if not 1e-13 <= width_s <= 1e-6:
        raise InvalidData(f"{stored.name}: bin_width_s is {width_s:g} s; expected 1e-13 to 1e-6 s")
    rectified, notes = _rectified(stored, given)
    notes += given.other_bins(stored.beside.get("bin_width_s"))
    exposed = _flat(stored, "exposure_s", counts.ndim)
    told = _order_told(stored, exposed, counts.shape[:-1])
    counts = given.ordered(counts, f"{stored.name}: {stored.place}", told)
    shape = counts.shape[:-1]
    if exposed is None:
        notes.append("exposure is not stored; assuming 1 s per point")
        exposed = np.ones(shape)
    elif exposed.size == 1:
        exposed = np.full(shape, exposed.item())
    elif (exposed := given.beside(exposed, shape)).shape != shape:
        raise InvalidData(
            f"{stored.name}: exposure_s: has shape {exposed.shape}, the scan {shape}: seconds for each point are "
            "expected, or one number for all"
        )
    counts, exposed = without_missing(counts, exposed, notes)
    offsets = _flat(stored, "time_offset_bins", counts.ndim)
    if offsets is not None and (offsets := given.beside(offsets, shape)).shape != shape:
        raise InvalidData(f"{stored.name}: time_offset_bins has shape {offsets.shape}, the scan {shape}")
    if offsets is not None and rectified and offsets.any():
        notes.append("not used: time_offset_bins, which align a raw scan; this one is rectified (if not: --raw)")
    begins_s = _number(stored, "offset_s", 0.0)
    early = _bins_before_wall(stored, begins_s, width_s, counts.shape[-1], rectified)
    if early:
        counts, offsets = counts[..., early:], None if offsets is None else offsets - early
        notes.append(f"the first {early} bins, which are before time 0, hold nothing hidden and are skipped")
    time = TimeAxis(counts.shape[-1], width_s, max(begins_s + early * width_s, 0.0) if early else begins_s)
    sides_m = given.wall_m or _wall_size(stored)
    cut = max(_direct_cut(stored, time.bins + early) - early, 0)
    if has_points(stored.name, stored.beside, rectified):
        after = np.where(np.arange(time.bins) < cut, 0, counts)
        placed = at_midpoints_of(stored.name, stored.beside, after, time)
        counts, exposed, time, cut = placed.counts, exposed.ravel(), placed.time, 0
        notes += placed.notes
        stored = replace(stored, beside={**stored.beside, "x_m": placed.x_m, "y_m": placed.y_m})
    if counts.ndim == 3 and not told and given.axes is None and sides_m is not None:
        refuse_turned_grid(f"{stored.name}: {stored.place}", shape, sides_m)
    known = not _flag(stored, "wall_size_assumed", False)
    held: Transient | FreePoints
    if counts.ndim == 3:
        places = (stored.beside.get(axis) for axis in ("x_m", "y_m"))
        placed_at = [
            None if each is None else given.places(axis, each, shape)
            for axis, each in zip(("x_m", "y_m"), places, strict=True)
        ]
        grid = on_even_grid(stored.name, shape, sides_m, *placed_at, told=given.wall_m is not None)
        notes += grid.notes
        if grid.sides_m is None and rectified:
            raise InvalidData(f"{stored.name}: wall_size_m: is not stored. {put_there('--wall-size-m W or WxH')}")
        if grid.sides_m is None:
            known = False
            notes.append(f"{NO_WALL}; assuming {ASSUMED}")
        counts, exposed = grid.upright(counts), grid.upright(exposed)
        offsets = None if offsets is None else grid.upright(offsets)
        cube = as_floats(np.moveaxis(counts, 2, 0))
        held = Transient(cube, exposed, WallGrid(*(grid.sides_m or assumed_sides_m(*shape)), *shape), time)
    else:
        held = _free(stored, counts, exposed, sides_m, time)
        if sides_m is None:
            held, moved = _centred(held)
            notes += moved
            notes.append(f"{NO_WALL}; by its points it is {held.wall.width_m:.4g} x {held.wall.height_m:.4g} m")
    if cut and not rectified:
        notes.append("not used: direct_cut_bins, which counts from time 0 of a rectified scan; this one is raw")
    if stored.others:
        more = ", ..." if len(stored.others) > MOST_NAMED else ""
        notes.append(f"not used: {', '.join(sorted(stored.others)[:MOST_NAMED])}{more}")
    return ImportedScan(
        held,
        stored.format,
        direct_cut_bins=cut if rectified else 0,
        falloff=_falloff(stored),
        rectified=rectified,
        rectified_assumed=NOT_SAID in notes,
        time_offset_bins=offsets,
        wall_known=known or given.wall_m is not None,
        response=_response(stored),
        notes=tuple(notes),
    )


def _rectified(stored: StoredArrays, given: Given) -> tuple[bool, list[str]]:
    """One rule for all arrays: rectified, unless the file or the user says otherwise."""
    if given.rectified is not None:
        return given.rectified, []
    if "rectified" in stored.beside:
        return _flag(stored, "rectified", True), []
    if "samples_left_aside" in stored.beside:
        raise InvalidData(
            f"{stored.name}: is an export of an earlier version, which did not store whether a scan is rectified. Say "
            "it: --rectified if time 0 is the wall point and direct light is gone, else --raw. Or export it again."
        )
    return True, [NOT_SAID]


def _bins_before_wall(stored: StoredArrays, begins_s: float, width_s: float, bins: int, rectified: bool) -> int:
    """How many bins of a rectified scan lie before time 0, where nothing hidden can be. Raises `InvalidData` where it
    cannot be."""
    if begins_s >= 0:
        return 0
    early = int(np.ceil(-begins_s / width_s - 1e-6))
    if not rectified or early >= bins:
        raise InvalidData(
            f"{stored.name}: offset_s is {begins_s:g} s: "
            + (
                f"all {bins} bins lie before the wall"
                if rectified
                else "of a raw scan it cannot be below 0; leave it out"
            )
        )
    return early


def _order_told(stored: StoredArrays, exposed: Array | None, shape: tuple[int, ...]) -> bool:
    """Whether arrays beside the histograms show these to be [H, W, T]."""
    if exposed is not None and exposed.shape == shape:
        return True
    places = [stored.beside.get(axis) for axis in ("y_m", "x_m")]
    return all(each is not None and each.size == count for each, count in zip(places, shape, strict=False))


def _free(
    stored: StoredArrays, counts: Array, exposed: Array, sides_m: tuple[float, float] | None, time: TimeAxis
) -> FreePoints:
    places = []
    for axis, side in (("x_m", 0), ("y_m", 1)):
        values = _flat(stored, axis, 1)
        if values is None:
            raise InvalidData(
                f"{stored.name}: {stored.place} of 2 dimensions [N, T] need {axis} [N], metres from the wall's centre"
            )
        if values.shape != (len(counts),):
            raise InvalidData(
                f"{stored.name}: {axis}: has shape {values.shape}; ({len(counts)},) is expected, one for each histogram"
            )
        if not np.isfinite(values).all():
            raise InvalidData(f"{stored.name}: {axis}: holds positions that are not finite")
        reach = float(np.abs(values).max())
        if sides_m is not None and reach > 1.001 * sides_m[side] / 2:
            raise InvalidData(
                f"{stored.name}: {axis} reaches {reach:g} m from the wall's centre, beyond the edge of a wall of "
                f"{sides_m[0]:g} x {sides_m[1]:g} m. Are both in metres, and is 0 the centre?"
            )
        places.append(values)
    wall = grid_around(places[0], places[1], sides_m)
    return FreePoints(as_floats(counts), exposed, places[0], places[1], wall, time)


def _centred(free: FreePoints) -> tuple[FreePoints, list[str]]:
    """Points of a wall of unknown size, about their own middle where all of them lie beside 0; and what is said."""
    x_m, y_m, said = about_their_middle(free.x_m, free.y_m)
    return (replace(free, x_m=x_m, y_m=y_m, wall=grid_around(x_m, y_m)), [said]) if said else (free, [])


def _direct_cut(stored: StoredArrays, bins: int) -> int:
    cut = _number(stored, "direct_cut_bins", 0.0)
    if not 0 <= cut < bins:
        raise InvalidData(f"{stored.name}: direct_cut_bins is {cut:g}, but histograms have {bins} bins")
    if not cut.is_integer():
        raise InvalidData(f"{stored.name}: direct_cut_bins is {cut:g}; whole bins are cut")
    return int(cut)


def _falloff(stored: StoredArrays) -> int | None:
    if "falloff_exponent_authors" not in stored.beside:
        return stored.falloff
    falloff = _number(stored, "falloff_exponent_authors")
    if falloff not in (2, 4):
        raise InvalidData(f"{stored.name}: falloff_exponent_authors is {falloff:g}; 2 or 4 are known")
    return int(falloff)


def _response(stored: StoredArrays) -> Response | None:
    curve = _flat(stored, "response", 1)
    step_s, fwhm_ps = (
        _number(stored, key) if key in stored.beside else None for key in ("response_bin_width_s", "response_fwhm_ps")
    )
    return stated(curve, step_s, fwhm_ps, stored.name)


def _wall_size(stored: StoredArrays) -> tuple[float, float] | None:
    if "wall_size_m" not in stored.beside:
        return None
    sizes = np.asarray(stored.beside["wall_size_m"])
    if sizes.dtype.kind not in "uif" or sizes.size not in (1, 2):
        raise InvalidData(
            f"{stored.name}: wall_size_m must be one number or width and height (found {_shown(sizes)}). "
            f"{put_there('--wall-size-m W or WxH')}"
        )
    sides = sizes.astype(np.float64).ravel()
    if not (np.isfinite(sides).all() and (sides > 0).all()):
        raise InvalidData(f"{stored.name}: wall_size_m is {_shown(sizes)}; metres above 0 are expected")
    return float(sides[0]), float(sides[-1])


def _flag(stored: StoredArrays, key: str, default: bool) -> bool:
    value = stored.beside.get(key, np.asarray(default))
    if value.size != 1 or value.dtype.kind not in "uifb" or value.reshape(()) not in (0, 1):
        remedy = f". {put_there('--rectified or --raw')}" if key == "rectified" else ""
        raise InvalidData(
            f"{stored.name}: {key} is {_shown(value.squeeze())}; true or false, 1 or 0 is expected{remedy}"
        )
    return bool(value.reshape(()))


def _number(stored: StoredArrays, key: str, default: float | None = None, option: str | None = None) -> float:
    value = stored.beside.get(key)
    if value is None and default is not None:
        return default
    remedy = f". {put_there(option)}" if option else ""
    if value is None:
        held = ", ".join(sorted({stored.place, *stored.beside, *stored.others})[:MOST_NAMED])
        raise InvalidData(f"{stored.name}: {key}, one finite number, is missing; the file holds {held}{remedy}")
    if value.size != 1 or value.dtype.kind not in "uifb" or not np.isfinite(value).all():
        raise InvalidData(f"{stored.name}: {key} must be one finite number (found {_shown(value)}){remedy}")
    return float(value.reshape(()))


def _flat(stored: StoredArrays, key: str, dimensions: int) -> npt.NDArray[np.float64] | None:
    """Numbers of as many dimensions as the points have; MATLAB knows no arrays of one."""
    value = stored.beside.get(key)
    if value is None:
        return None
    if value.dtype.kind not in "uifb" or value.size == 0:
        raise InvalidData(f"{stored.name}: {key}: holds {value.dtype} {value.shape}, not real numbers")
    values = value.astype(np.float64)
    one_line = sum(side > 1 for side in value.shape) <= 1
    return values.ravel() if one_line and (key in _ONE or dimensions == 2) else values


def _shown(value: Array) -> str:
    return repr(value.tolist()) if value.size < 5 else f"{value.dtype} {value.shape}"
