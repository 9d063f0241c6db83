"""Whether a scan file holds what was planned, and every sample as it was measured."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nlos.acquisition.recording.condition import Condition
from nlos.acquisition.recording.ended_as_asked import AS_ASKED, status_word
from nlos.acquisition.recording.frames import ended_plan, frame_table
from nlos.acquisition.recording.layout import Status
from nlos.acquisition.recording.recording import Recording


@dataclass(frozen=True)
class Verification:
    """What `verify` found: in which condition the rows are, and plan numbers stored twice or not at all; of a plan of
    candidates, `planned` are those that were taken and those that still fit its time; of a film until it is stopped,
    those up to the last one taken."""

    status: Status
    planned: int
    rows: Condition
    repeated: tuple[int, ...]
    missing: tuple[int, ...]
    frames: int = 1
    complete_frames: int = 0
    status_word: str = ""
    """What `nlos` calls the status."""

    @property
    def written(self) -> int:
        """Samples that were acknowledged or are intact."""
        return self.rows.samples

    @property
    def corrupt(self) -> tuple[int, ...]:
        """Rows that are known not to be what was measured."""
        return self.rows.damaged

    @property
    def intact(self) -> bool:
        """Whether every sample that was taken is what was measured."""
        return not self.rows.left_aside and not self.repeated

    @property
    def complete(self) -> bool:
        """Whether every planned sample is there, and what was measured."""
        return self.intact and not self.missing

    @property
    def as_asked(self) -> bool:
        """Whether the scan ended because its picture was good enough, as somebody had asked."""
        return self.status_word == AS_ASKED


def verify(path: Path) -> Verification:
    """Checks every sample's CRC. Raises `InvalidData` where `path` is no scan file, `StorageError` where the disk does
    not say."""
    with Recording.open(path) as recording:
        plan = ended_plan(recording.plan, recording.intact_records())
        missing = tuple(plan.pending(recording.photons()))
        condition = recording.condition()
        aside = [*condition.damaged, *condition.unread, *condition.unacknowledged]
        numbers, times = np.unique(np.delete(recording.records["number"], aside), return_counts=True)
        repeated = tuple(numbers[times > 1].tolist())
        table = frame_table(plan, recording.intact_records())
        planned = len(plan) if plan.budget is None else len(numbers) + len(missing)
        word = status_word(recording)
        return Verification(recording.status, planned, condition, repeated, missing, plan.frames, table.complete, word)
