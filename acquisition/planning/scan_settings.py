"""The scan file: wall, pattern, dwell and histogram, and the plan that they make."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.exposure import Exposure, SecondLook, TwoPass, Uniform
from nlos.acquisition.planning.frames import MOST_FRAMES, Parts, in_frames, most_frames
from nlos.acquisition.planning.ordering import strips, two_opt
from nlos.acquisition.planning.patterns import SCATTERED, Pattern
from nlos.acquisition.planning.patterns.adaptive import Adaptive
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import Positions
from nlos.acquisition.scanning.alarms import AlarmSettings
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings
from nlos.drivers.tcspc.counter import HistogramAxis

UNTIL_STOPPED = "until_stopped"
EDGE_M = 1e-9
LARGEST_BYTES = 8 << 30
"""Of all histograms of a plan: what is read back into one piece."""
LARGEST_WALL_M = 100.0


class WallSettings(Settings):
    """The scanned part of the relay wall, and the grid on it."""

    width_m: float = Field(gt=0)
    """Width of the scanned area."""
    height_m: float = Field(gt=0)
    """Height of the scanned area."""
    rows: int = Field(ge=1, le=4096)
    """Pixels from top to bottom."""
    cols: int = Field(ge=1, le=4096)
    """Pixels from left to right."""

    @field_validator("width_m", "height_m")
    @classmethod
    def _in_metres(cls, value: float) -> float:
        if value > LARGEST_WALL_M:
            raise ValueError(
                f"a wall of {value:g} m is larger than {LARGEST_WALL_M:g} m; write metres, not millimetres"
            )
        return value


class HistogramSettings(Settings):
    """The time axis that the counter is set to: `bins` of `bin_width_ps`, from `offset_ns` after the sync pulse."""

    bins: int = Field(ge=64, le=65536)
    """Time bins per point."""
    bin_width_ps: float = Field(gt=0, le=1e6)
    """Width of a bin; one that the counter has."""
    offset_ns: float = Field(default=0.0, ge=0, le=1e8)
    """Start of the histogram after the sync pulse."""


class ContinuousSettings(Settings):
    """Lines may be swept without settling, where the beam is found to be within `within_pixels` of each point; else the
    points are taken one by one."""

    within_pixels: float = Field(default=0.25, gt=0, le=0.25)
    """How many steps of a line the beam may be away from a point in the middle of its dwell."""


class ScanSettings(Settings):
    """A scan file. `dwell_ms` is each point's time before the exposure policy distributes it.

    `order`: `pattern` as the pattern lists them, `strips` boustrophedon strips, `two_opt` shorter still and slower to
    find; without it, scattered points are visited in strips and the others as their pattern lists them.
    """

    wall: WallSettings
    """The scanned area and its grid."""
    pattern: Pattern
    """Which points are measured: `nlos patterns`."""
    dwell_ms: float = Field(ge=0.001, le=10_000)
    histogram: HistogramSettings
    """The time axis."""
    exposure: Exposure = Uniform()
    """How the dwell is distributed over the points: uniform unless given."""
    alarms: AlarmSettings = AlarmSettings()
    """Limits, and what to do at each."""
    continuous: ContinuousSettings | None = None
    """Sweep lines without settling."""
    order: Literal["pattern", "strips", "two_opt"] | None = None
    """The order of the points: as the pattern lists them, in strips, or by a shorter path."""
    frames: Annotated[int, Field(ge=1, le=MOST_FRAMES)] | Literal["until_stopped"] = 1
    """How many times the points are scanned: frames of one recording, for scenes that move. Exposure is each one's.
    `until_stopped`: until Ctrl-C, or as many as a recording holds."""
    interleave: Parts = 1
    """Each frame takes one of so many parts of the points, evenly spread, the next frame the next part."""

    def plan(self) -> ScanPlan:
        """The plan. Raises `PlanRefused` where pattern, exposure and wall do not fit together."""
        wall = WallGrid(self.wall.width_m, self.wall.height_m, self.wall.rows, self.wall.cols)
        axis = HistogramAxis(self.histogram.bins, self.histogram.bin_width_ps * 1e-12, self.histogram.offset_ns * 1e-9)
        listed = self.pattern.points(wall)
        if isinstance(self.pattern, Adaptive):
            return self._candidates(self.pattern, listed, wall, axis)
        frames = self._frames(len(listed), axis.bins)
        self._check_size(len(listed), frames, axis.bins)
        positions = self._ordered(listed)
        beyond = np.maximum(np.abs(positions.x_m) / wall.width_m, np.abs(positions.y_m) / wall.height_m)
        if beyond.max() > 0.5 + EDGE_M:
            first = int(np.argmax(beyond))
            raise PlanRefused(
                f"point {first} at ({positions.x_m[first]:g}, {positions.y_m[first]:g}) m lies outside the wall of "
                f"{wall.width_m:g} x {wall.height_m:g} m"
            )
        stop = self.exposure.stop(axis)
        if stop is not None and self.continuous is not None:
            raise PlanRefused("points that stop at N counts make an uneven pace; take out `continuous` or the exposure")
        if isinstance(self.exposure, SecondLook) and self.continuous is not None:
            raise PlanRefused("second looks lie on no lines; take out `continuous` or exposure second_look")
        visits = self.exposure.visits(positions, wall, self.dwell_ms * 1e-3)
        if frames > 1 or self.interleave > 1:
            if isinstance(self.exposure, TwoPass | SecondLook):
                raise PlanRefused(
                    f"a frame has no second pass: take out exposure {self.exposure.kind}, or frames and interleave"
                )
            visits = in_frames(positions, visits, frames, self.interleave)
        return ScanPlan(
            wall,
            axis,
            positions.take(visits.index),
            visits.dwell_s,
            visits.pass_,
            stop,
            self.exposure.revisit_below,
            self.continuous.within_pixels if self.continuous else None,
            self.exposure.budget(visits),
            until_stopped=self.frames == UNTIL_STOPPED,
        )

    def _candidates(self, pattern: Adaptive, positions: Positions, wall: WallGrid, axis: HistogramAxis) -> ScanPlan:
        """Every visit that may be taken. Raises `PlanRefused` for what would decide the same things otherwise."""
        others = {
            "exposure": not isinstance(self.exposure, Uniform),
            "frames": self.frames != 1,
            "interleave": self.interleave > 1,
            "continuous": self.continuous is not None,
            "order": self.order is not None,
        }
        if found := [name for name, given in others.items() if given]:
            raise PlanRefused(
                f"pattern adaptive chooses points, order and dwell itself: take out {' and '.join(found)}"
            )
        visits = pattern.visits(positions, self.dwell_ms * 1e-3)
        budget = pattern.budget(visits)
        self._check_size(budget.most(budget.costs_us(visits.dwell_s)), 1, axis.bins)
        return ScanPlan(wall, axis, positions.take(visits.index), visits.dwell_s, visits.pass_, budget=budget)

    def _frames(self, points: int, bins: int) -> int:
        """How many there are of so many points; until the film is stopped, as many as a recording of it may hold."""
        if not isinstance(self.frames, str):
            return self.frames
        most = most_frames(points, self.interleave, bins, LARGEST_BYTES)
        if most == 1 and 4 * points * bins <= LARGEST_BYTES:  # more than that is refused below
            raise PlanRefused(
                f"frames: {UNTIL_STOPPED}: a recording of {LARGEST_BYTES / 1e9:.1f} GB holds a single frame of "
                f"{points} points and {bins} bins, which is no film. Plan fewer points or bins."
            )
        return most

    def _check_size(self, points: int, frames: int, bins: int) -> None:
        """Raises `PlanRefused` for more counts than are read back into one piece."""
        visits = -(-points * frames // self.interleave)
        if (size := 4 * visits * bins) > LARGEST_BYTES:
            fewer = "fewer frames, points or bins" if frames > 1 else "fewer points or bins"
            raise PlanRefused(
                f"{visits} points of {bins} bins are {size / 1e9:.1f} GB of counts; a recording of more than "
                f"{LARGEST_BYTES / 1e9:.1f} GB is not read back. Plan {fewer}, or several scans."
            )

    def _ordered(self, positions: Positions) -> Positions:
        order = self.order or ("strips" if isinstance(self.pattern, SCATTERED) else "pattern")
        if order == "pattern":
            return positions
        find = strips if order == "strips" else two_opt
        return positions.take(find(positions.x_m, positions.y_m))
