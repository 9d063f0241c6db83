"""Measurements and virtual channels of a simulated Time Tagger: what the vendor's library makes of the tags."""

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from nlos.drivers.simulated.timetagger.tags import PS, FrontPanel, Tags

_NONE: Tags = (np.zeros(0, np.int64), np.zeros(0, np.int32))
_FIRST_VIRTUAL = 1001


class Tagger(Protocol):
    """The instrument, as its measurements see it."""

    panel: FrontPanel
    hub: "Hub"

    def check_channel(self, channel: int) -> None:
        """Raises `ValueError` where there is none, `RuntimeError` where the instrument is closed."""
        ...

    def clicks_a_second(self, channel: int) -> float: ...


class Hub:
    """Hands tags to whatever runs, virtual channels included."""

    def __init__(self, instrument: Tagger) -> None:
        self.instrument = instrument
        self.virtual: dict[int, tuple[list[int], int]] = {}
        """Channel -> those that it repeats, and how much later (ps)."""
        self._running: list[Measurement] = []

    def add_virtual(self, channels: list[int], delay_ps: int) -> int:
        number = _FIRST_VIRTUAL + len(self.virtual)
        self.virtual[number] = (channels, delay_ps)
        return number

    def begin(self, measurement: "Measurement", until_s: float | None) -> None:
        self.pull()
        self._running = [each for each in self._running if each.running and each is not measurement]
        self._running.append(measurement)
        self.instrument.panel.begin(until_s)

    def pull(self) -> None:
        """Brings everything that runs up to now."""
        running = [each for each in self._running if each.running]
        if not running:
            return
        tags = self.instrument.panel.pull()
        for each in running:
            each.take(*self._seen(tags, each.channels))

    def _seen(self, tags: Tags, wanted: list[int]) -> Tags:
        times, channels = [], []
        for channel in dict.fromkeys(wanted):
            at = self._of(tags, channel)
            times.append(at)
            channels.append(np.full(len(at), channel, np.int32))
        time = np.concatenate(times) if times else _NONE[0]
        order = np.argsort(time, kind="stable")
        return time[order], (np.concatenate(channels) if channels else _NONE[1])[order]

    def _of(self, tags: Tags, channel: int) -> npt.NDArray[np.int64]:
        if channel not in self.virtual:
            return np.asarray(tags[0][tags[1] == channel])
        sources, delay_ps = self.virtual[channel]
        return np.asarray(np.sort(np.concatenate([self._of(tags, each) for each in sources])) + delay_ps)


class Combiner:
    def __init__(self, tagger: Tagger, channels: list[int]) -> None:
        for channel in channels:
            tagger.check_channel(channel)
        self._number = tagger.hub.add_virtual(list(channels), 0)

    def getChannel(self) -> int:
        return self._number


class DelayedChannel:
    def __init__(self, tagger: Tagger, input_channel: int, delay: int) -> None:
        tagger.check_channel(input_channel)
        self._number = tagger.hub.add_virtual([input_channel], delay)

    def getChannel(self) -> int:
        return self._number


class Measurement:
    """Runs from its creation."""

    channels: list[int]

    def __init__(self, tagger: Tagger, channels: list[int]) -> None:
        for channel in channels:
            tagger.check_channel(channel)
        self._tagger, self.channels, self.running = tagger, channels, False
        self._ends_s: float | None = None
        self.clear()
        self.start()

    def clear(self) -> None:
        if self.running:
            self._tagger.hub.pull()
        self.forget()

    def forget(self) -> None:
        raise NotImplementedError

    def take(self, times: npt.NDArray[np.int64], channels: npt.NDArray[np.int32]) -> None:
        raise NotImplementedError

    def start(self) -> None:
        self._begin(None)

    def startFor(self, capture_duration: int, clear: bool = True) -> None:
        if clear:
            self.clear()
        self._begin(self._tagger.panel.bench.clock.now() + capture_duration * PS)

    def _begin(self, ends_s: float | None) -> None:
        self._tagger.check_channel(1)
        self._ends_s, self.running = ends_s, True
        self._tagger.hub.begin(self, ends_s)

    def stop(self) -> None:
        if self.running:
            self._tagger.panel.stop()
            self._tagger.hub.pull()
        self.running = False

    def isRunning(self) -> bool:
        if self.running and self._ends_s is not None and self._tagger.panel.bench.clock.now() >= self._ends_s - 1e-9:
            self._tagger.hub.pull()
            self.running = False
        return self.running

    def _pulled(self) -> None:
        if self.isRunning():
            self._tagger.hub.pull()


class Histogram(Measurement):
    def __init__(
        self, tagger: Tagger, click_channel: int, start_channel: int, binwidth: int = 1000, n_bins: int = 1000
    ) -> None:
        self._click, self._start, self._width, self._bins = click_channel, start_channel, binwidth, n_bins
        super().__init__(tagger, [click_channel, start_channel])

    def forget(self) -> None:
        self._counts, self._last = np.zeros(self._bins, np.int32), np.iinfo(np.int64).min // 2

    def take(self, times: npt.NDArray[np.int64], channels: npt.NDArray[np.int32]) -> None:
        starts = np.append(self._last, times[channels == self._start])
        clicks = times[channels == self._click]
        bins = (clicks - starts[np.searchsorted(starts, clicks, side="right") - 1]) // self._width
        self._counts += np.bincount(bins[bins < self._bins], minlength=self._bins).astype(np.int32)
        self._last = int(starts[-1])

    def getData(self) -> npt.NDArray[np.int32]:
        self._pulled()
        return self._counts.copy()


class Countrate(Measurement):
    def forget(self) -> None:
        self._seen = np.zeros(len(self.channels))

    def take(self, times: npt.NDArray[np.int64], channels: npt.NDArray[np.int32]) -> None:
        """Rates are those of the inputs, not of what passes a filter."""

    def _begin(self, ends_s: float | None) -> None:
        self._tagger.check_channel(1)
        self._ends_s, self.running = ends_s, True

    def stop(self) -> None:
        self.running = False

    def getData(self) -> npt.NDArray[np.float64]:
        return np.array([self._tagger.clicks_a_second(channel) for channel in self.channels])


class TimeTagStream(Measurement):
    def __init__(self, tagger: Tagger, n_max_events: int, channels: list[int]) -> None:
        self._most = n_max_events
        super().__init__(tagger, list(channels))

    def forget(self) -> None:
        self._tags = [_NONE]

    def take(self, times: npt.NDArray[np.int64], channels: npt.NDArray[np.int32]) -> None:
        self._tags.append((times, channels))

    def getData(self) -> "TagBuffer":
        self._pulled()
        times = np.concatenate([each[0] for each in self._tags])[: self._most]
        channels = np.concatenate([each[1] for each in self._tags])[: self._most]
        self.forget()
        return TagBuffer(times, channels, self._tagger.panel.told_ps())


class TagBuffer:
    def __init__(self, times: npt.NDArray[np.int64], channels: npt.NDArray[np.int32], until_ps: int) -> None:
        self._times, self._channels, self.tGetData = times, channels, until_ps

    def getTimestamps(self) -> npt.NDArray[np.int64]:
        return self._times

    def getChannels(self) -> npt.NDArray[np.int32]:
        return self._channels

    def getEventTypes(self) -> npt.NDArray[np.uint8]:
        return np.zeros(len(self._times), np.uint8)


class Flim(Measurement):
    """Pixels begin and end with edges; a frame is complete with its last pixel, and the next one begins."""

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
    ) -> None:
        self._start, self._click, self._begin_at, self._end_at = (
            start_channel, click_channel, pixel_begin_channel, pixel_end_channel,
        )  # fmt: skip
        self._pixels, self._bins, self._width = n_pixels, n_bins, binwidth
        super().__init__(tagger, [start_channel, click_channel, pixel_begin_channel, pixel_end_channel])

    def forget(self) -> None:
        self._left = _NONE
        self._frame = np.zeros((self._pixels, self._bins), np.uint32)
        self._begins: list[int] = []
        self._ends: list[int] = []

    def take(self, times: npt.NDArray[np.int64], channels: npt.NDArray[np.int32]) -> None:
        self._left = np.concatenate((self._left[0], times)), np.concatenate((self._left[1], channels))

    def _sorted(self) -> "FrameInfo":
        """Pixels whose end is past: what a delayed edge encloses is known then."""
        self._pulled()
        told_ps = self._tagger.panel.told_ps() + self._tagger.panel.period_ps  # edges are told to a laser pulse
        times, channels = self._left
        begins, ends = (np.sort(times[channels == each]) for each in (self._begin_at, self._end_at))
        ends = ends[ends <= told_ps][: self._pixels - len(self._ends)]
        clicks, starts = np.sort(times[channels == self._click]), np.sort(times[channels == self._start])
        for begin_ps, end_ps in zip(begins.tolist(), ends.tolist(), strict=False):
            inside = clicks[np.searchsorted(clicks, begin_ps) : np.searchsorted(clicks, end_ps)]
            first = starts[np.searchsorted(starts, inside, side="right") - 1]
            bins = (inside - first) // self._width
            self._frame[len(self._ends)] = np.bincount(bins[bins < self._bins], minlength=self._bins)
            self._begins.append(begin_ps)
            self._ends.append(end_ps)
        if len(ends):
            last = times > ends[-1] - self._tagger.panel.period_ps  # and the laser pulse of the next photon
            edges = np.isin(channels, (self._begin_at, self._end_at))
            left = np.where(edges, times > np.where(channels == self._end_at, ends[-1], begins[len(ends) - 1]), last)
            self._left = times[left], channels[left]
        return FrameInfo(self._frame, np.array(self._begins), np.array(self._ends), len(self._ends))

    def getFramesAcquired(self) -> int:
        return int(self._sorted().getPixelPosition() == self._pixels)

    def getCurrentFrameEx(self) -> "FrameInfo":
        return self._sorted()

    def getReadyFrameEx(self, index: int = -1) -> "FrameInfo":
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
