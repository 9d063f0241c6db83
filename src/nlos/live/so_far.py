"""The samples of a scan so far, ready to be calibrated, without opening the file again."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nlos.acquisition.scanning.free_points import FreePoints
from nlos.acquisition.scanning.gathering import Gathering
from nlos.acquisition.scanning.newest_visits import NewestVisits
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.calibration.raw_points import RawPoints
from nlos.loaded import LoadedScan, as_recorded

if TYPE_CHECKING:
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.recording.recording import Recording


def gathering_for(plan: "ScanPlan") -> "Gathering | FreePoints":
    """An empty sum for this plan. Raises `InvalidData` where it would need more than 8 GiB."""
    return Gathering(plan) if plan.positions.on_grid else FreePoints(plan)


def shown_of(plan: "ScanPlan") -> "Gathering | FreePoints":
    """An empty sum of what a viewer shows: of a film the newest visit to every point, else every sample. Raises
    `InvalidData` as `gathering_for` does."""
    return NewestVisits(plan) if plan.frames > 1 and plan.positions.on_grid else gathering_for(plan)


def new_scan(plan: "ScanPlan", devices: Mapping[str, str], bench_json: str = "{}") -> "LoadedScan":
    """A scan that is being taken, without samples."""
    transient, nothing = _nothing(plan)
    return LoadedScan(transient, devices, nothing, nothing, False, None, None, None, bench_json=bench_json)


def empty_scan(recording: "Recording") -> "LoadedScan":
    """What the file says of itself, as a scan without samples."""
    transient, nothing = _nothing(recording.plan)
    return as_recorded(recording, transient, nothing, nothing)


def _nothing(plan: "ScanPlan") -> "tuple[Transient, npt.NDArray[np.float64]]":
    wall, axis = plan.wall, plan.axis
    nothing = np.zeros((wall.rows, wall.cols))
    counts = np.broadcast_to(np.float32(0), (axis.bins, *nothing.shape))  # takes no memory
    return Transient(counts, nothing, wall, TimeAxis(axis.bins, axis.bin_width_s, axis.offset_s)), nothing


def scan_of(empty: "LoadedScan", so_far: "Gathering | FreePoints") -> "LoadedScan":
    """The same file with the samples gathered so far. Copies: adding more does not change it."""
    if isinstance(so_far, Gathering):
        return replace(
            empty, transient=so_far.transient(), sync_count=so_far.sync_count.copy(),
            total_count=so_far.total_count.copy(),
        )  # fmt: skip
    seen = np.flatnonzero(so_far.exposure_s > 0)
    return replace(
        empty,
        points=RawPoints(
            so_far.counts[seen], so_far.x_m[seen], so_far.y_m[seen], so_far.exposure_s[seen], so_far.sync_count[seen],
            so_far.total_count[seen], so_far.time,
        ),
    )  # fmt: skip
