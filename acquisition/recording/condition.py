"""How a recording is: which of its rows are what was measured, which are not, and which nobody could read."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from nlos.drivers.tcspc.counter import HistogramFlag


class RowState(IntEnum):
    """What can be said of a row."""

    INTACT = 0
    DAMAGED = 1
    """It was acknowledged, and is not what was written then."""
    UNREAD = 2
    """The disk did not give it: nobody knows what it is, and perhaps the next attempt does."""
    UNACKNOWLEDGED = 3
    """On its way to the disk, or half written when the process died; nothing was promised about it."""


@dataclass(frozen=True)
class Condition:
    """Row numbers by what can be said of them."""

    rows: int
    """Rows acknowledged or written."""
    damaged: tuple[int, ...]
    unread: tuple[int, ...]
    unacknowledged: tuple[int, ...]
    full: tuple[int, ...] = ()
    """Intact, but the counter says that a bin of it could not count further."""

    @classmethod
    def of(cls, states: npt.NDArray[np.uint8], flags: npt.NDArray[np.uint16]) -> "Condition":
        """From the `RowState` and the `HistogramFlag` of every row."""

        def rows(state: RowState) -> tuple[int, ...]:
            return tuple(np.flatnonzero(states == state).tolist())

        saturated = (flags & HistogramFlag.SATURATED) != 0
        full = tuple(np.flatnonzero(saturated & (states == RowState.INTACT)).tolist())

        return cls(len(states), rows(RowState.DAMAGED), rows(RowState.UNREAD), rows(RowState.UNACKNOWLEDGED), full)

    @property
    def samples(self) -> int:
        """Rows that hold a sample, or held one once."""
        return self.rows - len(self.unacknowledged)

    @property
    def intact(self) -> int:
        return self.samples - self.left_aside

    @property
    def in_one_piece(self) -> bool:
        """Whether every intact row comes before every other."""
        return all(row >= self.intact for row in (*self.damaged, *self.unread, *self.unacknowledged))

    @property
    def left_aside(self) -> int:
        """Samples that no result may use: damaged ones and those that cannot be read."""
        return len(self.damaged) + len(self.unread)

    @property
    def warning(self) -> str:
        """What a person has to know; empty where every sample is used and holds all of its light."""
        return "; ".join(filter(None, [self._skipped, self.full_words]))

    @property
    def full_words(self) -> str:
        """What to say of samples that hold too little; empty where there are none."""
        if not self.full:
            return ""
        return (
            f"{len(self.full)} of {self.samples} samples hold a bin that was full (rows {listed(self.full)}): there "
            "the counter counted no further, so light is missing, and no picture or constant comes of it"
        )

    @property
    def _skipped(self) -> str:
        found = [
            f"{word} {listed(rows)}"
            for word, rows in (("damaged: rows", self.damaged), ("cannot be read: rows", self.unread))
            if rows
        ]
        return f"{self.left_aside} of {self.samples} samples are skipped ({'; '.join(found)})" if found else ""


def listed(numbers: Sequence[int], most: int = 8) -> str:
    """Ascending numbers for people: runs as 3-17, at most so many of them."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    words = [f"{first}" if first == last else f"{first}-{last}" for first, last in runs]
    return ", ".join(words[:most]) + (f" and {len(words) - most} more runs" if len(words) > most else "")
