"""Measurements and virtual channels of a simulated Time Tagger: what the vendor's library makes of the tags."""

import math
from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np
import numpy.typing as npt

from nlos.drivers.simulated.timetagger.tags import PS, FrontPanel, Tags

NONE: Tags = (np.zeros(0, np.int64), np.zeros(0, np.int32))
_FIRST_VIRTUAL = 1001


class Tagger(Protocol):
    """The instrument, as its measurements see it."""

    panel: FrontPanel
    hub: "Hub"

    def check_channel(self, channel: int) -> None:
        """Raises `ValueError` where there is none, `RuntimeError` where the instrument is closed."""
        ...

    def clicks_a_second(self, channel: int) -> float:
        """What a rate meter says of a channel."""
        ...


class Hub:
    """Hands tags to whatever runs, virtual channels included."""

    def __init__(self, instrument: Tagger) -> None:
        self.instrument = instrument
        self.virtual: dict[int, tuple[list[int], int]] = {}
        """Channel -> those that it repeats, and how much later (ps)."""
        self._running: list[Measurement] = []

    def add_virtual(self, channels: list[int], delay_ps: int) -> int:
        """A channel that repeats others, later; its number."""
        number = _FIRST_VIRTUAL + len(self.virtual)
        self.virtual[number] = (channels, delay_ps)
        return number

    def begin(self, measurement: "Measurement", until_s: float | None) -> None:
        """From now on tags go to this one, too."""
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
        time = np.concatenate(times) if times else NONE[0]
        order = np.argsort(time, kind="stable")
        return time[order], (np.concatenate(channels) if channels else NONE[1])[order]

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


class Measurement(ABC):
    """Runs from its creation. By the vendor's name it cannot be made itself."""

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

    @abstractmethod
    def forget(self) -> None:
        """What was measured so far does not count."""

    @abstractmethod
    def take(self, times: npt.NDArray[np.int64], channels: npt.NDArray[np.int32]) -> None:
        """Tags of its own channels, in time order: ps and channels, both (n,)."""

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
        """Rates are asked for as they are read."""

    def _begin(self, ends_s: float | None) -> None:
        self._tagger.check_channel(1)
        self._begun_s, self._ends_s, self.running = self._tagger.panel.bench.clock.now(), ends_s, True

    def stop(self) -> None:
        self.running = False

    def getData(self) -> npt.NDArray[np.float64]:
        """Whole clicks between begin and end."""
        now_s = self._tagger.panel.bench.clock.now()
        ended_s = now_s if self._ends_s is None else min(now_s, self._ends_s)
        rates = [self._tagger.clicks_a_second(channel) for channel in self.channels]
        counted = [math.floor(ended_s * each) - math.floor(self._begun_s * each) for each in rates]
        return np.array(counted) / max(ended_s - self._begun_s, 1e-12)


class TimeTagStream(Measurement):
    def __init__(self, tagger: Tagger, n_max_events: int, channels: list[int]) -> None:
        self._most = n_max_events
        super().__init__(tagger, list(channels))

    def forget(self) -> None:
        self._tags = [NONE]

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
