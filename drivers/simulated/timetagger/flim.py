"""`Flim` of a simulated Time Tagger: a histogram a pixel, between edges that begin and end it."""

from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.drivers.simulated.timetagger.measurements import NONE, Measurement, Tagger

CHANNEL_UNUSED = -134_217_728


class Flim(Measurement):
    """Pixels begin and end with edges; a frame is complete with its last pixel. Of `finish_after_outputframe` frames
    each can be asked for by its number; where that is 0, nothing but the latest one."""

    def __init__(
        self,
        tagger: Tagger,
        start_channel: int,
        click_channel: int,
        pixel_begin_channel: int,
        n_pixels: int,
        n_bins: int,
        binwidth: int,
        pixel_end_channel: int,
        frame_begin_channel: int = CHANNEL_UNUSED,
        finish_after_outputframe: int = 0,
    ) -> None:
        if frame_begin_channel != CHANNEL_UNUSED or finish_after_outputframe > 1:
            raise NotImplementedError("of one frame, which its pixels begin")
        self._frames = finish_after_outputframe
        self._start, self._click, self._begin_at, self._end_at = (
            start_channel, click_channel, pixel_begin_channel, pixel_end_channel,
        )  # fmt: skip
        self._pixels, self._bins, self._width = n_pixels, n_bins, binwidth
        super().__init__(tagger, [start_channel, click_channel, pixel_begin_channel, pixel_end_channel])

    def forget(self) -> None:
        self._left = NONE
        self._frame = np.zeros((self._pixels, self._bins), np.uint32)
        self._begins: list[int] = []
        self._ends: list[int] = []

    def take(self, times: npt.NDArray[np.int64], channels: npt.NDArray[np.int32]) -> None:
        self._left = np.concatenate((self._left[0], times)), np.concatenate((self._left[1], channels))

    def _sorted(self) -> "FrameInfo":
        """Edges that are past: what a delayed one encloses is known then. A pixel under way ends with whichever edge
        comes next; of two at one time the order is open, and here the worse one."""
        self._pulled()
        told_ps = self._tagger.panel.told_ps() + self._tagger.panel.period_ps  # edges are told to a laser pulse
        times, channels = self._left
        told = times <= told_ps
        begins, ends = (np.sort(times[told & (channels == each)]) for each in (self._begin_at, self._end_at))
        clicks, starts = np.sort(times[channels == self._click]), np.sort(times[channels == self._start])
        edges = sorted([*((at, False) for at in begins.tolist()), *((at, True) for at in ends.tolist())])
        for at_ps, is_end in edges:
            if len(self._begins) > len(self._ends):
                self._close(at_ps, clicks, starts)
            if not is_end and len(self._begins) < self._pixels:
                self._begins.append(at_ps)
        since_ps = self._begins[-1] if len(self._begins) > len(self._ends) else told_ps
        is_edge = np.isin(channels, (self._begin_at, self._end_at))
        left = np.where(is_edge, ~told, times > since_ps - self._tagger.panel.period_ps)
        self._left = times[left], channels[left]
        return FrameInfo(self._frame, np.array(self._begins), np.array(self._ends), len(self._ends))

    def _close(self, end_ps: int, clicks: npt.NDArray[np.int64], starts: npt.NDArray[np.int64]) -> None:
        inside = clicks[np.searchsorted(clicks, self._begins[-1]) : np.searchsorted(clicks, end_ps)]
        first = starts[np.searchsorted(starts, inside, side="right") - 1]
        bins = (inside - first) // self._width
        self._frame[len(self._ends)] = np.bincount(bins[bins < self._bins], minlength=self._bins)
        self._ends.append(end_ps)

    def getFramesAcquired(self) -> int:
        return int(self._sorted().getPixelPosition() == self._pixels)

    def getCurrentFrameEx(self) -> "FrameInfo":
        return self._sorted()

    def getReadyFrameEx(self, index: int = -1) -> "FrameInfo":
        if index >= self._frames:
            raise ValueError("frame is out of bounds or on unlimited mode")
        return self._sorted()


class FrameInfo:
    def __init__(self, frame: Any, begins: Any, ends: Any, position: int) -> None:
        self._frame, self._begins, self._ends, self._position = frame, begins, ends, position

    def getPixelPosition(self) -> int:
        return self._position

    def getHistograms(self) -> npt.NDArray[np.uint32]:
        return np.asarray(self._frame)

    def getPixelBegins(self) -> npt.NDArray[np.int64]:
        return np.asarray(self._begins)

    def getPixelEnds(self) -> npt.NDArray[np.int64]:
        return np.asarray(self._ends)
