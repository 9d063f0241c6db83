"""The frames of a recording: where each one's rows lie, when it was taken, and what it holds."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.plan import ScanPlan


def rows_of(plan: ScanPlan, records: npt.NDArray[Any], frames: range) -> range:
    """The rows between which everything of `frames` lies; rows of other frames may lie between them as well, where
    points were taken again. Raises `InvalidData` for a frame that the plan has not."""
    if not (frames.step == 1 and 0 <= frames.start < frames.stop <= plan.frames):
        one = f"frame {frames.start}" if len(frames) == 1 else f"frames {frames.start} to {frames.stop - 1}"
        raise InvalidData(f"{one}: the recording has {plan.frames}, from 0 to {plan.frames - 1}")
    frame = frame_of_rows(plan, records)
    rows = np.flatnonzero((frame >= frames.start) & (frame < frames.stop))
    return range(int(rows[0]), int(rows[-1]) + 1) if len(rows) else range(0)


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


def frame_table(plan: ScanPlan, records: npt.NDArray[Any]) -> FrameTable:
    """The table of intact rows (`RECORD`), those of `Recording.intact_records`."""
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
        planned=np.bincount(plan.pass_, minlength=frames) if frames > 1 else np.array([len(plan)]),
        points=points,
        start_s=np.where(none, np.nan, start_s),
        end_s=np.where(none, np.nan, end_s),
        mean_s=mean_s,
        live_s=live_s,
        pulses=added(records["sync_count"]).astype(np.int64),
        photons=added(records["total_count"]).astype(np.int64),
        flagged=added(records["flags"] != 0).astype(np.int64),
    )
