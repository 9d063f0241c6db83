"""The frames of a recording: where each one's rows lie, when it was taken, and what it holds."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.plan import ScanPlan

LEAST_PART = 0.75
"""Of a frame's points: with fewer it is a part of one."""
LONGEST = 2.0
"""How many times as long as usual what makes a picture may have taken: else points of it were taken again later."""


def rows_of(plan: ScanPlan, records: npt.NDArray[Any], frames: range) -> range:
    """The rows between which everything of `frames` lies; rows of other frames may lie between them as well, where
    points were taken again. Raises `InvalidData` for a frame that the plan has not."""
    begun = ended_plan(plan, records).frames
    if not (frames.step == 1 and 0 <= frames.start < frames.stop <= begun):
        one = f"frame {frames.start}" if len(frames) == 1 else f"frames {frames.start} to {frames.stop - 1}"
        raise InvalidData(f"{one}: the recording has {begun}, from 0 to {begun - 1}")
    frame = frame_of_rows(plan, records)
    rows = np.flatnonzero((frame >= frames.start) & (frame < frames.stop))
    return range(int(rows[0]), int(rows[-1]) + 1) if len(rows) else range(0)


def ended_plan(plan: ScanPlan, records: npt.NDArray[Any]) -> ScanPlan:
    """What was planned; of a film until it is stopped, as if it were now: up to the last point taken (intact rows,
    `RECORD`), and all of the wall once."""
    if not plan.until_stopped:
        return plan
    number = records["number"][records["number"] < len(plan)]
    return plan.ended_after(max(int(number.max(initial=0)) + 1, plan.first_round))


def frame_of_rows(plan: ScanPlan, records: npt.NDArray[Any]) -> npt.NDArray[np.int32]:
    """The frame of each row, (n,); -1 where the row's number is none of the plan's."""
    number = np.minimum(records["number"], len(plan) - 1)
    return np.where(records["number"] < len(plan), plan.pass_[number], -1).astype(np.int32)


@dataclass(frozen=True, eq=False)
class FrameTable:
    """What is known of every frame, arrays of length F; times are NaN where nothing was taken."""

    planned: npt.NDArray[np.int64]
    """Points of the plan."""
    points: npt.NDArray[np.int64]
    """Points taken."""
    start_s: npt.NDArray[np.float64]
    """When the first of its points was begun, on the bench's clock since the scan's start."""
    end_s: npt.NDArray[np.float64]
    """When the last of its points was over."""
    mean_s: npt.NDArray[np.float64]
    """The mean moment of its exposure: where something that moves evenly is seen."""
    live_s: npt.NDArray[np.float64]
    """Its exposure in all."""
    pulses: npt.NDArray[np.int64]
    """Laser pulses during it, as the counter's sync input saw them: over `live_s` the laser's rate, 0 without laser."""
    photons: npt.NDArray[np.int64]
    """Detections, those outside of the histogram too."""
    flagged: npt.NDArray[np.int64]
    """Points with a flag."""

    @property
    def complete(self) -> int:
        """How many frames have all their points."""
        return int(np.count_nonzero(self.points == self.planned))

    @property
    def pace_hz(self) -> float | None:
        """Complete frames a second, whatever pauses there were; None where there is none."""
        whole = self.points == self.planned
        start_s = np.sort(self.start_s[whole])
        took_s = np.diff(start_s) if len(start_s) > 1 else (self.end_s - self.start_s)[whole]
        usual_s = float(np.median(took_s)) if len(took_s) else 0.0
        return 1 / usual_s if usual_s > 0 else None

    def said(self) -> str:
        """How many are complete, and how fast they came."""
        pace = "" if self.pace_hz is None else f", {self.pace_hz:.3g} a second"
        return f"{self.complete} of {len(self.planned)} complete{pace}"

    def mean_of(self, frames: range) -> float:
        """The mean moment of the exposure of some frames, as one."""
        some = slice(frames.start, frames.stop)
        return float(np.average(self.mean_s[some], weights=self.live_s[some]))

    def pictured(self, each: int) -> "PicturedFrames":
        """Which `each` successive frames make a picture."""
        took: dict[range, float] = {}
        short: list[int] = []
        for first in range(len(self.planned) - each + 1):
            some = slice(first, first + each)
            if (self.points[some] < LEAST_PART * self.planned[some]).any():
                short += [] if (self.points[some] == 0).any() else [first + each - 1]
            else:
                took[range(first, first + each)] = float(self.end_s[some].max() - self.start_s[some].min())
        usual_s = sorted(took.values())[(len(took) - 1) // 2] if took else 0.0
        kept = sorted((frames for frames in took if took[frames] <= LONGEST * usual_s), key=self.mean_of)
        late = [frames.stop - 1 for frames in took if took[frames] > LONGEST * usual_s]
        return PicturedFrames(tuple(kept), tuple(short), tuple(late))


@dataclass(frozen=True)
class PicturedFrames:
    """What makes pictures of a film, in the order of time; the last frame of what does not."""

    frames: tuple[range, ...]
    short: tuple[int, ...]
    """Of too few points."""
    late: tuple[int, ...]
    """Points of it were taken at quite another moment, as after a pause."""


def frame_table(plan: ScanPlan, records: npt.NDArray[Any]) -> FrameTable:
    """The table of intact rows (`RECORD`), those of `Recording.intact_records`; of a film until it is stopped, of the
    frames that it has by now."""
    plan = ended_plan(plan, records)
    frames = plan.frames
    frame = frame_of_rows(plan, records) if frames > 1 else np.zeros(len(records), dtype=np.int32)

    def added(values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        return np.bincount(frame, weights=values.astype(np.float64), minlength=frames).astype(np.float64)

    live_s, points = added(records["live_time_s"]), np.bincount(frame, minlength=frames)
    start_s, end_s = np.full(frames, np.inf), np.full(frames, -np.inf)
    np.minimum.at(start_s, frame, records["taken_s"])
    np.maximum.at(end_s, frame, records["taken_s"] + records["live_time_s"])
    middle_s = records["taken_s"] + records["live_time_s"] / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_s = added(middle_s * records["live_time_s"]) / live_s
    none = points == 0
    return FrameTable(
        planned=plan.frame_points,
        points=points,
        start_s=np.where(none, np.nan, start_s),
        end_s=np.where(none, np.nan, end_s),
        mean_s=mean_s,
        live_s=live_s,
        pulses=added(records["sync_count"]).astype(np.int64),
        photons=added(records["total_count"]).astype(np.int64),
        flagged=added(records["flags"] != 0).astype(np.int64),
    )
