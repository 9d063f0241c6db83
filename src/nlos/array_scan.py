"""A scan from NumPy arrays: every way in which they can be meant, told apart or refused."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, SupportsFloat

import numpy as np
import numpy.typing as npt

from nlos.acquisition.importers.given import Given
from nlos.acquisition.importers.imported import SUBTRACTED
from nlos.acquisition.transient import MOST_COUNTS, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid, about_their_middle, grid_around
from nlos.calibration.raw_points import RawPoints
from nlos.file_doubts import doubt
from nlos.loaded import LoadedScan
from nlos.recon.errors import InvalidData
from nlos.recon.gridding import grid_samples

log = logging.getLogger(__name__)
Array = npt.NDArray[np.floating[Any] | np.integer[Any]]
Size = float | Sequence[float] | Array
Places = Sequence[npt.ArrayLike] | Array
ARRAYS = "histograms"
"""What they are called in warnings."""
AXES = {"T": "T", "Y": "Y", "H": "Y", "X": "X", "W": "X", "N": "N"}


def scan_from_arrays(
    histograms: npt.ArrayLike,
    *,
    bin_width: float | None,
    wall: Size | None,
    points: Places | None = None,
    axes: str | None = None,
    exposure: npt.ArrayLike | None = None,
    rectified: bool | None = None,
) -> LoadedScan:
    """A scan from histograms [H, W, T], or [N, T] with `points=(x_m, y_m)`; `axes` names another order.

    `wall`: its side, or width and height, in metres; `bin_width` in seconds. `rectified`: time 0 is the wall and direct
    light is gone, which is assumed unless said. What the light denies is logged (`file_doubts`). Raises `InvalidData`
    saying what was given and what is expected.
    """
    width_s = _bin_width(bin_width)
    counts = _ordered(_numbers(histograms, "histograms"), axes, points is not None)
    shape = counts.shape[:-1]
    counts, masked = _unmasked(counts)
    _refuse_bad(counts)
    if exposure is None:
        exposed = np.ones(shape)
    else:
        exposed = np.asarray(np.ma.filled(_numbers(exposure, "exposure"), 0), dtype=np.float64)
        if exposed.shape != shape:
            raise InvalidData(f"exposure has shape {exposed.shape}; {shape} is expected, seconds per point.")
    exposed = np.where(masked, 0.0, exposed)
    time = TimeAxis(counts.shape[-1], width_s)
    assumed, rectified = rectified is None, rectified is None or rectified
    if points is None:
        scan = _on_grid(counts, exposed, _wall(wall, *shape), time, rectified)
        doubt(ARRAYS, scan.transient, wall_known=True, direct_light=not rectified)
        return replace(scan, rectified_assumed=assumed)
    x_m, y_m = _places(points, len(counts))
    if wall is None:
        x_m, y_m, said = about_their_middle(x_m, y_m)
        if said:
            log.warning("%s: %s", ARRAYS, said)
    grid = grid_around(x_m, y_m, None if wall is None else _sides(wall))
    nothing = np.zeros(len(counts))
    free = RawPoints(counts, x_m, y_m, exposed, nothing, nothing, time)
    on_grid = grid_samples(x_m, y_m, counts, exposed, grid, time)
    doubt(ARRAYS, on_grid, wall_known=True, direct_light=False)
    empty = np.zeros_like(on_grid.exposure_s)
    return LoadedScan(on_grid, {}, empty, empty, rectified, None, None, None, points=free,
                      rectified_assumed=assumed)  # fmt: skip


def said_of_file(
    wall: Size | None, bin_width: float | None, axes: str | None, rectified: bool | None, detector: int | None = None
) -> Given:
    """What the words for arrays say about a file, as the options of the command line do. Raises `InvalidData`."""
    wall_m = None if wall is None else _sides(wall)
    return Given(wall_m, None if bin_width is None else _bin_width(bin_width), axes, rectified, detector)


def whether_rectified(said: object) -> bool | None:
    """What was said, as files and arrays hold it, too: `np.False_`, 0, an array of one. None: nothing.

    Raises `InvalidData` for what is no answer.
    """
    if said is None:
        return None
    held = np.asarray(said)
    if held.size != 1 or held.dtype.kind not in "bui" or held.item() not in (0, 1):
        raise InvalidData(f"rectified={said!r}: True (time 0 is the wall, direct light is gone) or False is expected.")
    return bool(held.item())


def _on_grid(
    counts: npt.NDArray[Any], exposure_s: npt.NDArray[np.float64], wall: WallGrid, time: TimeAxis, rectified: bool
) -> LoadedScan:
    cube = np.ascontiguousarray(np.moveaxis(counts, -1, 0), dtype=np.float32)
    nothing = np.zeros_like(exposure_s)
    return LoadedScan(Transient(cube, exposure_s, wall, time), {}, nothing, nothing, rectified, None, None, None)


def in_its_numbers(transient: Transient) -> Transient:
    """The same, whatever kind of number its arrays were changed to. Raises `InvalidData` for what holds none."""
    if np.ma.is_masked(transient.counts):
        raise InvalidData("counts are masked. Set exposure_s to 0 at points that were not measured.")
    counts, exposure_s = _numbers(transient.counts, "counts"), _numbers(transient.exposure_s, "exposure_s")
    return replace(
        transient,
        counts=np.asarray(counts, dtype=np.float32),
        exposure_s=np.asarray(np.ma.filled(exposure_s, 0), dtype=np.float64),
    )


def _numbers(values: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
    try:
        array = np.asanyarray(values) if np.ma.isMaskedArray(values) else np.asarray(values)
    except ValueError as error:
        raise InvalidData(f"{name}: lists of unequal lengths; an array of numbers is expected.") from error
    except (RuntimeError, TypeError) as error:  # a tensor on a GPU, of a kind that NumPy lacks, or with a gradient
        why = str(error).rstrip(".")
        raise InvalidData(f"{name}: {type(values).__name__} is not read as a NumPy array: {why}.") from error
    if array.dtype.kind not in "uifb":
        raise InvalidData(f"{name} hold {array.dtype}; an array of real numbers is expected.")
    return array


def _bin_width(bin_width: float | None) -> float:
    if bin_width is None:
        raise InvalidData("bin_width is missing: the width of a time bin in seconds, for example bin_width=32e-12.")
    if not isinstance(bin_width, SupportsFloat) or np.ndim(bin_width) > 0:
        raise InvalidData(f"bin_width={bin_width!r}: a number of seconds is expected, for example bin_width=32e-12.")
    if not 1e-13 <= bin_width <= 1e-6:
        hint = f" Did you mean bin_width={bin_width:g}e-12?" if 0.1 <= bin_width <= 1e6 else ""
        if 1e-5 <= bin_width < 0.1:
            hint = " Divide nanoseconds by 1e9, metres of the light's way by 299792458."
        raise InvalidData(f"bin_width={bin_width:g}: seconds between 1e-13 and 1e-6 are expected.{hint}")
    return float(bin_width)


def _ordered(array: npt.NDArray[Any], axes: str | None, free: bool) -> npt.NDArray[Any]:
    """[H, W, T], or [N, T] for free positions."""
    expected = "NT" if free else "YXT"
    shown = "[N, T] (points, time bins)" if free else "[H, W, T] (rows, columns, time bins)"
    if array.ndim != len(expected):
        more = " Histograms [N, T] need points=(x_m, y_m)." if array.ndim == 2 and not free else ""
        raise InvalidData(f"histograms have shape {array.shape}; {shown} is expected.{more}")
    if 0 in array.shape:
        raise InvalidData(f"histograms have shape {array.shape}: there is nothing in them.")
    if axes is not None:
        named = "".join(AXES.get(letter, letter) for letter in str(axes).upper())
        if sorted(named) != sorted(expected):
            raise InvalidData(f"axes='{axes}': the letters of '{expected}' are expected, in the order of the array.")
        array = np.transpose(array, [named.index(letter) for letter in expected])
    elif not free and array.shape[1] == array.shape[2] != array.shape[0]:
        raise InvalidData(
            f"histograms have shape {array.shape}: is time the first axis? Pass axes='TYX' if so, "
            "axes='YXT' if this is [H, W, T] as it is."
        )
    return array


def _unmasked(counts: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[np.bool_]]:
    """Plain counts, 0 at points that are masked (`numpy.ma`) and so were not measured; and which those are."""
    if not np.ma.isMaskedArray(counts):
        return counts, np.zeros(counts.shape[:-1], dtype=bool)
    mask: npt.NDArray[np.bool_] = np.asarray(np.ma.getmaskarray(counts))
    masked: npt.NDArray[np.bool_] = np.asarray(mask.all(axis=-1))
    partly = mask & ~masked[..., None]
    if partly.any():
        place = tuple(int(i) for i in np.argwhere(partly)[0])
        raise InvalidData(
            f"histograms{list(place)} is masked, other bins of that point are not ({int(partly.sum())} of {mask.size} "
            "values). Mask all bins of a point that was not measured, or fill the masked bins."
        )
    return np.ma.filled(counts, 0), masked


def _refuse_bad(counts: npt.NDArray[Any]) -> None:
    bad = ~np.isfinite(counts) if counts.dtype.kind == "f" else np.zeros(0, dtype=bool)
    what = "not a finite number"
    if not bad.any():
        bad, what = counts < 0, "negative"
    if not bad.any():
        with np.errstate(over="ignore"):  # float16 ends far below
            bad = counts > MOST_COUNTS
        what = f"more than anybody counts, {MOST_COUNTS:.2g}"
    if bad.any():
        place = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InvalidData(
            f"histograms{list(place)} is {counts[place]:g}: {what} ({int(bad.sum())} of {bad.size} values). "
            + (SUBTRACTED.replace("Store", "Give").lstrip() + " " if what == "negative" else "")
            + "Set a point that was not measured to 0 and say so by exposure=... (0 there)."
        )


def _sides(wall: Size) -> tuple[float, float]:
    try:
        sides = np.asarray(wall, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        sides = np.zeros(0)
    if sides.size not in (1, 2) or not np.isfinite(sides).all() or (sides <= 0).any() or (sides > 100).any():
        raise InvalidData(f"wall={wall!r}: its side, or (width, height), in metres between 0 and 100 is expected.")
    return float(sides[0]), float(sides[-1])


def _wall(wall: Size | None, rows: int, cols: int) -> WallGrid:
    if wall is None:
        raise InvalidData("wall is missing: width and height of the scanned wall in metres, e.g. wall=(2.0, 2.0).")
    return WallGrid(*_sides(wall), rows, cols)


def _places(points: Places, count: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    if len(points) != 2:
        raise InvalidData(f"points holds {len(points)} arrays; points=(x_m, y_m) is expected, one number per point.")
    if any(np.ma.is_masked(values) for values in points):
        raise InvalidData("points: a position is masked. Leave that point out of points and histograms.")
    x_m, y_m = (np.asarray(_numbers(values, "points"), dtype=np.float64) for values in points)
    if x_m.shape != (count,) or y_m.shape != (count,):
        raise InvalidData(f"points have shapes {x_m.shape} and {y_m.shape}; ({count},) each is expected.")
    if not (np.isfinite(x_m).all() and np.isfinite(y_m).all()):
        raise InvalidData("points: a position is not a finite number.")
    return x_m, y_m
