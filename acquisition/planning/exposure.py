"""How long the beam dwells on each point, when it stops early, and where it comes back."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from nlos.acquisition.errors import InvalidData, PlanRefused
from nlos.acquisition.planning.budget import Budget as TimeBudget
from nlos.acquisition.planning.positions import Positions
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag, StopAtCounts

DWELL_STEP_S = 1e-6
"""Dwells are whole microseconds: what counters can be set to exactly."""
_ROUNDING_US = 1e-6
"""A share that comes to whole microseconds is one, however its quotient is rounded."""
MAX_MAP_BYTES = 64 << 20
GOLDEN = (math.sqrt(5) - 1) / 2
LEAST_BATCH, BATCHES = 32, 4
"""How many second looks are chosen together: a path through fewer costs more than their choice gains."""

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Visits:
    """Which position is visited when, for how long, in which pass."""

    index: npt.NDArray[np.intp]  # (M,) into the positions
    dwell_s: Floats  # (M,)
    pass_: npt.NDArray[np.int32]  # (M,)


def whole_microseconds(dwell_s: npt.ArrayLike) -> Floats:
    """`dwell_s` on the counters' grid of microseconds, at least one."""
    return np.maximum(np.round(np.asarray(dwell_s, dtype=np.float64) / DWELL_STEP_S), 1.0) * DWELL_STEP_S


def unbiased_live_s(live_s: Floats, flags: npt.NDArray[np.uint16], stop: StopAtCounts | None) -> Floats:
    """Live times by which counts are divided. A point stopped by its N-th count came out high: counts / live time
    would be N/T where (N - 1)/T is unbiased, so such a point's time counts N/(N - 1) fold."""
    if stop is None:
        return live_s
    early = (flags & HistogramFlag.STOPPED_EARLY) != 0
    return np.where(early, live_s * (stop.counts / (stop.counts - 1)), live_s)


def unbiased_s(histogram: Histogram, stop: StopAtCounts | None) -> float:
    """The same of one histogram."""
    flags = np.array([histogram.flags], dtype=np.uint16)
    return float(unbiased_live_s(np.array([histogram.live_time_s]), flags, stop)[0])


class _Exposure(Settings):
    """One visit to every position with the same dwell: what the policies below change."""

    def visits(self, positions: Positions, wall: WallGrid, dwell_s: float) -> Visits:
        """One visit to every position, its dwell weighted by `weights`, with a mean of `dwell_s`."""
        weights = self.weights(positions, wall)
        index = np.flatnonzero(weights > 0)
        if not len(index):
            raise PlanRefused("no point has a dwell above 0")
        share = weights[index] / weights[index].mean()
        return Visits(index, whole_microseconds(share * dwell_s), np.zeros(len(index), dtype=np.int32))

    def weights(self, positions: Positions, wall: WallGrid) -> Floats:
        """Relative dwell of every position, shape (N,); 0 leaves it out."""
        return np.ones(len(positions))

    def stop(self, axis: HistogramAxis) -> StopAtCounts | None:
        """When points end before their dwell is over."""
        return None

    def budget(self, visits: Visits) -> TimeBudget | None:
        """The time for `visits` that are more than are taken."""
        return None

    @property
    def revisit_below(self) -> int | None:
        """Below how many counts a point is visited again."""
        return None


class Uniform(_Exposure):
    """The same dwell everywhere."""

    kind: Literal["uniform"] = "uniform"


class Budget(_Exposure):
    """A total dwell time, split equally; `dwell_ms` is the longest dwell that makes sense."""

    kind: Literal["budget"] = "budget"
    total_s: float = Field(gt=0)
    """Dwell of all points together."""

    def visits(self, positions: Positions, wall: WallGrid, dwell_s: float) -> Visits:
        """Rounded down to whole microseconds. Raises `PlanRefused` where there is more time than needed, or none."""
        share_us = self.total_s * 1e6 / len(positions) + _ROUNDING_US
        if share_us > dwell_s * 1e6 + 2 * _ROUNDING_US:
            raise PlanRefused(
                f"{self.total_s:g} s for {len(positions)} points are {share_us / 1e3:.3g} ms each, more than dwell_ms "
                f"({dwell_s * 1e3:g}); lower total_s or raise dwell_ms"
            )
        if share_us < 1:
            raise PlanRefused(f"{self.total_s:g} s are less than a microsecond for each of {len(positions)} points")
        return super().visits(positions, wall, math.floor(share_us) * DWELL_STEP_S)


class ByDistance(_Exposure):
    """Dwell grows with the distance to where the hidden object is thought to be; `dwell_ms` is the mean.

    `falloff`: light returns as 1/r^4 from diffuse and 1/r^2 from retroreflective surfaces; dwell makes up for it.
    """

    kind: Literal["by_distance"] = "by_distance"
    x_m: float
    """Where the object is thought to be."""
    y_m: float
    """Where the object is thought to be."""
    z_m: float = Field(gt=0)
    """Its depth behind the wall."""
    falloff: Literal[2, 4] = 4
    """4 for diffuse, 2 for retroreflective surfaces: the dwell compensates for it."""

    def weights(self, positions: Positions, wall: WallGrid) -> Floats:
        """r^falloff."""
        squared = (positions.x_m - self.x_m) ** 2 + (positions.y_m - self.y_m) ** 2 + self.z_m**2
        return np.asarray(squared ** (self.falloff / 2), dtype=np.float64)


class ByMap(_Exposure):
    """Dwell as drawn in a map: a CSV file of relative dwells, top row first, stretched over the wall; 0 leaves points
    out. `dwell_ms` is the mean of the others."""

    kind: Literal["by_map"] = "by_map"
    file: str
    """The CSV file, relative to the current folder."""

    def weights(self, positions: Positions, wall: WallGrid) -> Floats:
        """The map's value at every position. Raises `InvalidData` naming the file."""
        weights = _read_map(Path(self.file))
        down = (0.5 - positions.y_m / wall.height_m) * weights.shape[0]
        across = (positions.x_m / wall.width_m + 0.5) * weights.shape[1]
        row = np.clip(down.astype(np.intp), 0, weights.shape[0] - 1)
        col = np.clip(across.astype(np.intp), 0, weights.shape[1] - 1)
        return np.asarray(weights[row, col], dtype=np.float64)


class StopAtNCounts(_Exposure):
    """Each point ends with its N-th count within a window of arrival times; `dwell_ms` is the longest it may take."""

    kind: Literal["stop_at_counts"] = "stop_at_counts"
    counts: int = Field(ge=2, le=2**31 - 1)
    """Counts at which a point ends."""
    from_ns: float = Field(ge=0)
    """Start of the window."""
    to_ns: float = Field(gt=0)
    """End of the window."""

    def stop(self, axis: HistogramAxis) -> StopAtCounts:
        """The window in bins. Raises `PlanRefused` where it is no part of the time axis."""
        first = math.floor((self.from_ns * 1e-9 - axis.offset_s) / axis.bin_width_s + 1e-6)
        end = math.ceil((self.to_ns * 1e-9 - axis.offset_s) / axis.bin_width_s - 1e-6)
        if not 0 <= first < end <= axis.bins:
            raise PlanRefused(
                f"the window of {self.from_ns:g} to {self.to_ns:g} ns is not within the histogram "
                f"({axis.offset_s * 1e9:g} to {(axis.offset_s + axis.bins * axis.bin_width_s) * 1e9:g} ns)"
            )
        return StopAtCounts(self.counts, first, end)


class TwoPass(_Exposure):
    """Everything once with `dwell_ms`, then `again_ms` more where a histogram holds fewer than `counts`."""

    kind: Literal["two_pass"] = "two_pass"
    counts: int = Field(ge=1)
    """Histograms with fewer are measured again."""
    again_ms: float = Field(ge=0.001, le=10_000)
    """Dwell of the second pass."""

    def visits(self, positions: Positions, wall: WallGrid, dwell_s: float) -> Visits:
        """Both passes in full: which points of the second are taken is decided by what the first counted."""
        count = len(positions)
        return Visits(
            index=np.tile(np.arange(count), 2),
            dwell_s=whole_microseconds(np.repeat([dwell_s, self.again_ms * 1e-3], count)),
            pass_=np.repeat(np.array([0, 1], dtype=np.int32), count),
        )

    @property
    def revisit_below(self) -> int:
        return self.counts


class SecondLook(_Exposure):
    """Everything once with `dwell_ms`, then `again_ms` more at a `share` of the points: where the picture is least
    sure. `--until` that comes before ends the scan."""

    kind: Literal["second_look"] = "second_look"
    again_ms: float = Field(ge=0.001, le=10_000)
    """Dwell of the second visits."""
    share: float = Field(default=0.25, gt=0, lt=1)
    """Of the points, those that are visited again."""

    def visits(self, positions: Positions, wall: WallGrid, dwell_s: float) -> Visits:
        """The first pass as the pattern has it; the second, which points of are taken is decided on the way, such that
        every beginning of it is spread evenly along the first."""
        count = len(positions)
        again = np.argsort(np.arange(count) * GOLDEN % 1.0, kind="stable")
        return Visits(
            index=np.concatenate([np.arange(count), again]),
            dwell_s=whole_microseconds(np.repeat([dwell_s, self.again_ms * 1e-3], count)),
            pass_=np.repeat(np.array([0, 1], dtype=np.int32), count),
        )

    def budget(self, visits: Visits) -> TimeBudget:
        """All of the first pass, and the second's share."""
        count, dwells_us = len(visits.index) // 2, np.round(visits.dwell_s * 1e6).astype(np.int64)
        again = max(1, round(self.share * count))
        total_us = int(dwells_us[:count].sum() + again * dwells_us[-1])
        return TimeBudget(total_us, 0, max(LEAST_BATCH, -(-again // BATCHES)), after_first=True)


Exposure = Annotated[
    Uniform | Budget | ByDistance | ByMap | StopAtNCounts | TwoPass | SecondLook, Field(discriminator="kind")
]


def _read_map(path: Path) -> Floats:
    if not path.is_file():
        raise InvalidData(f"{path}: no such file; a relative path starts where the command is called")
    if path.stat().st_size > MAX_MAP_BYTES:
        raise InvalidData(f"{path}: is larger than {MAX_MAP_BYTES >> 20} MB")
    try:
        weights = np.loadtxt(path, delimiter=",", ndmin=2, dtype=np.float64, encoding="utf-8-sig")
    except ValueError as error:
        raise InvalidData(f"{path}: is not a table of numbers with as many in every line ({error})") from error
    if not weights.size or not np.isfinite(weights).all() or (weights < 0).any() or not (weights > 0).any():
        raise InvalidData(f"{path}: relative dwells must be 0 or above, and one of them above 0")
    return weights
