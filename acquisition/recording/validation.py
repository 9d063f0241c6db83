"""What a scan file may say, validated: whatever one states passes here before anybody computes with it.

Checksums tell what was damaged on the way; a file that somebody made states what it likes under checksums that fit.
"""

import json
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.wall import WallGrid
from nlos.drivers.tcspc.counter import HistogramAxis

LARGEST_WALL_M = 100.0
MAX_POINTS = 4096 * 4096
MAX_BINS = 65536
NARROWEST_BIN_S, WIDEST_BIN_S = 1e-13, 1e-6
LONGEST_S = 1e8
"""Three years: no scan, and nothing in one, takes longer."""


def json_object(place: str, text: str) -> dict[str, Any]:
    """The JSON object in `text`. Raises `InvalidData` for text that is none, or nested beyond reading."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidData(f"{place}: is not readable JSON ({str(error)[:80]})") from error
    if not isinstance(found, dict):
        raise InvalidData(f"{place}: is not a JSON object but {type(found).__name__}")
    return found


def json_texts(place: str, text: str) -> list[str]:
    """The list of texts in `text`. Raises `InvalidData`."""
    found = json_object(place, f'{{"texts": {text}}}')["texts"]
    if not isinstance(found, list) or not all(isinstance(one, str) for one in found):
        raise InvalidData(f"{place}: is not a list of texts")
    return found


def check_geometry(name: str, wall: WallGrid, axis: HistogramAxis, points: int) -> None:
    """Raises `InvalidData` for a wall or time axis that no scan has, before anything is allocated for it."""
    if not (0 < wall.width_m <= LARGEST_WALL_M and 0 < wall.height_m <= LARGEST_WALL_M):
        raise InvalidData(f"{name}: plan: the wall is {wall.width_m:g} x {wall.height_m:g} m; expected at most 100 m")
    if wall.rows * wall.cols > MAX_POINTS or not 0 < points <= MAX_POINTS:
        raise InvalidData(f"{name}: plan: {points} points on a grid of {wall.rows} x {wall.cols}; 4096 x 4096 at most")
    if not (0 < axis.bins <= MAX_BINS and NARROWEST_BIN_S <= axis.bin_width_s <= WIDEST_BIN_S):
        raise InvalidData(f"{name}: plan: {axis.bins} bins of {axis.bin_width_s:g} s are not a time axis")
    if not 0 <= axis.offset_s <= 1:
        raise InvalidData(f"{name}: plan: the time axis begins at {axis.offset_s:g} s; expected 0 to 1 s")


def check_plan(name: str, plan: ScanPlan) -> None:
    """Raises `InvalidData`, naming the first point, for places, dwells and passes that no plan has."""
    places, wall = plan.positions, plan.wall
    on_grid = (places.row >= 0) & (places.row < wall.rows) & (places.col >= 0) & (places.col < wall.cols)
    off_grid = (places.row == -1) & (places.col == -1)
    for good, what in (
        (on_grid | off_grid, f"lies outside the grid of {wall.rows} x {wall.cols}"),
        (np.isfinite(places.x_m) & np.isfinite(places.y_m), "has a position that is not finite"),
        (plan.dwell_s <= LONGEST_S, "has a dwell of more than three years"),
        ((plan.pass_ >= 0) & (plan.pass_ < len(plan)), "is in a pass that does not exist"),
    ):
        if not good.all():
            raise InvalidData(f"{name}: plan: point {int(np.argmin(good))} {what}")
    if plan.first_pass == 0:
        raise InvalidData(f"{name}: plan: pass 0 has no points")
    stop, within_px = plan.stop, plan.within_px
    if stop is not None and not (stop.counts > 0 and 0 <= stop.first_bin < stop.end_bin <= plan.axis.bins):
        raise InvalidData(f"{name}: plan: stop at {stop.counts} counts in bins {stop.first_bin} to {stop.end_bin}")
    if plan.budget is not None and not (plan.budget.total_us <= LONGEST_S * 1e6 and plan.most_samples):
        raise InvalidData(
            f"{name}: plan: a budget of {plan.budget.total_us} us holds none of its points, or any number"
        )
    if (plan.revisit_below or 0) < 0 or not 0 <= (within_px or 0.0) <= 1:
        raise InvalidData(f"{name}: plan: revisit_below {plan.revisit_below}, within_px {within_px}")


def plausible_rows(records: npt.NDArray[Any], points: int) -> npt.NDArray[np.bool_]:
    """Which rows of records (`RECORD`) state what a counter can have said, of a plan of so many points."""
    good: npt.NDArray[np.bool_] = records["number"] < points
    for field in ("taken_s", "live_time_s", "gate_opened_s"):
        good &= np.abs(records[field]) <= LONGEST_S  # neither for NaN nor for infinity
    good &= records["live_time_s"] >= 0
    return good


def check_status(name: str, state: int, acknowledged: int, points: int, states: tuple[int, ...]) -> None:
    """Raises `InvalidData` for a status that the file format does not know."""
    if state not in states:
        raise InvalidData(f"{name}: status: state {state} is unknown; {states[0]} to {states[-1]} are known")
    if acknowledged > points:
        raise InvalidData(f"{name}: status: {acknowledged} samples are acknowledged of a plan of {points} points")


def chunks_fit(item: h5py.Dataset) -> bool:
    """Whether a dataset can hold no more than its shape says, in chunks that are no larger than it."""
    chunks = item.chunks or ()
    return item.maxshape == item.shape and all(0 < n <= m for n, m in zip(chunks, item.shape, strict=False))
