"""Photons of a scan that marks where its lines begin and end, sorted into points: the line's time in equal parts."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Times = npt.NDArray[np.int64]


@dataclass(frozen=True)
class MarkedLines:
    """The lines of a scan, in the order in which they were drawn; times in the clock of the photons."""

    start: Times  # (L,)
    stop: Times  # (L,)
    row: npt.NDArray[np.intp]  # (L,) counted from the frame's first line

    def dwell(self, rows: int, cols: int) -> npt.NDArray[np.float64]:
        """How long each point was looked at in all frames (H, W), in the clock of the photons."""
        each = np.bincount(self.row, (self.stop - self.start) / cols, minlength=rows)
        return np.repeat(each[:, None], cols, axis=1)

    def points(
        self, times: Times, cols: int, two_ways: bool = False
    ) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
        """Row-major point of each photon within a line, and which photons are within one. `two_ways`: every second line
        of a frame is drawn backwards."""
        line = np.searchsorted(self.start, times, side="right") - 1
        within = (line >= 0) & (times < self.stop[line])
        line, times = line[within], times[within]
        start, stop = self.start[line], self.stop[line]
        col = (times - start) * cols // (stop - start)
        row = self.row[line]
        if two_ways:
            col = np.where(row % 2 == 1, cols - 1 - col, col)
        return row * cols + col, within


def marked_lines(starts: Times, stops: Times, frames: Times) -> MarkedLines:
    """Lines from the times of their marks, each in rising order; a line that is not ended before the next one begins
    is none. A frame goes to its mark; without marks all lines are of one frame."""
    after = np.searchsorted(stops, starts, side="right")
    ended = after < len(stops)
    stop = np.where(ended, stops[np.minimum(after, len(stops) - 1)] if len(stops) else 0, 0)
    ended &= stop <= np.append(starts[1:], np.iinfo(np.int64).max)
    starts, stop = starts[ended], stop[ended]
    frame = np.searchsorted(frames, starts, side="right")
    first = np.searchsorted(frame, frame)  # of the frame that a line is in
    return MarkedLines(starts, stop, np.arange(len(starts)) - first)
