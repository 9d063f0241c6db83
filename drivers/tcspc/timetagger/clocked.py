"""Points stepped by a Time Tagger's AUX OUT and told apart by the mirror's markers: by the vendor's `Flim`, or by tags.

The `xtra_` calls drive AUX OUT of the Time Tagger X; that its first edge comes as it is enabled, and how it stops, is
not in the vendor's reference: watch it on an oscilloscope before the first scan.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from nlos.drivers.errors import LimitError
from nlos.drivers.tcspc.counter import HistogramAxis, PointGates
from nlos.drivers.tcspc.t3 import T3Events, T3Format
from nlos.drivers.tcspc.t3_points import PointHistograms, StepMarkers, steps_by_times
from nlos.drivers.tcspc.timetagger.settings import TimeTaggerSettings
from nlos.drivers.tcspc.timetagger.tagger import PS, Tagger

_STEP_MARKERS = 0b011
_DISORDER_PS = 50_000_000
_MOST_TAGS = 4_000_000
_STEPS_EARLY_S, _MOST_OF_A_DWELL = 20e-6, 0.1
"""By so much the next step may come before its time, and at most by so much of a dwell."""
_TIME_TAG = 0
_TAGS = T3Format("time tags", 0, 32, 1 << 31, 0, False)
"""Photons as bins, times in ps: what sorts T3 records sorts tags as well."""


@dataclass(frozen=True)
class Period:
    """The laser's, in bins of the axis; `first`: the axis begins with this one."""

    sync_hz: float
    first: int
    bins: int


class Point(NamedTuple):
    """What was seen of a point."""

    counts: npt.NDArray[Any]
    """Over the laser period (bins,)."""
    opened_s: float
    """When its gate opened, by the instrument's own time."""
    live_s: float
    lost: bool


class Clocked(Protocol):
    """Points between two markers, as they come in."""

    @property
    def complete(self) -> int:
        """Points before this one will not change any more."""
        ...

    def begin(self) -> None:
        """Forgets what was seen, and starts the clock where it is the instrument's."""
        ...

    def look(self) -> int:
        """Takes what has come; how many points are complete."""
        ...

    def steps(self) -> tuple[int, int]:
        """Markers seen while the points were due, and how many there were by their times."""
        ...

    def lost_points(self) -> int:
        """How many points had tags lost."""
        ...

    def point(self, k: int) -> "Point":
        """What was seen of point k, which is complete."""
        ...

    def end(self) -> None:
        """Stops clock and measurement."""
        ...


class PixelClock:
    """AUX OUT at one period; without a number another clock steps the mirror. Raises `LimitError` where the instrument
    makes another period of it."""

    def __init__(self, tagger: Tagger, number: int | None, period_s: float) -> None:
        self._tagger, self._number, self.period_s = tagger, number, period_s
        if number is None:
            return
        tagger.set("xtra_setAuxOutSignal", number, 1 / period_s)
        made_hz = float(tagger.set("xtra_getAuxOutSignalFrequency", number))
        if abs(made_hz * period_s - 1) > 1e-6:
            raise LimitError(
                tagger.device,
                f"AUX OUT {number} makes {made_hz:g} Hz of a period of {period_s * 1e3:g} ms.",
                "Change dwell_ms.",
            )

    def run(self, on: bool) -> None:
        """Starts or stops it."""
        if self._number is not None:
            self._tagger.set("xtra_setAuxOut", self._number, on)


@dataclass(frozen=True)
class Stepped:
    """Points that a clock steps: how they are wired, what is histogrammed of each, and when it is due."""

    settings: TimeTaggerSettings
    axis: HistogramAxis
    period: Period
    gates: PointGates
    clock: PixelClock


class ByFlim:
    """The vendor's library sorts: a pixel begins `blanking` after a step marker and ends a dwell later, or, without
    blanking, a little earlier than that: what begins before the last pixel's end has come would end with it."""

    def __init__(self, tagger: Tagger, stepped: Stepped) -> None:
        axis, period, gates, settings = stepped.axis, stepped.period, stepped.gates, stepped.settings
        points, dwell_s, blanking_s = len(gates.dwells_s), gates.dwells_s[0], gates.blanking_s
        self._tagger, self._points = tagger, points
        self._step_ps, self._clock = round(stepped.clock.period_s / PS), stepped.clock
        step = tagger.measurement("Combiner", list(settings.markers[:2]))
        channel = tagger.call("getChannel", step.getChannel)
        begin = tagger.measurement("DelayedChannel", channel, round(blanking_s / PS))
        closes_s = blanking_s + dwell_s - max(0.0, min(_STEPS_EARLY_S, dwell_s * _MOST_OF_A_DWELL) - blanking_s)
        end = tagger.measurement("DelayedChannel", channel, round(closes_s / PS))
        self._channels = (step, begin, end)  # a virtual channel lives as long as somebody holds it
        self._bins = period.bins + (period.bins == points)  # so that the two axes of a frame can be told apart
        self._period_bins = period.bins
        self._flim = tagger.measurement(
            "Flim", settings.sync.channel, settings.detector.channel, tagger.call("getChannel", begin.getChannel),
            points, self._bins, round(axis.bin_width_s / PS), tagger.call("getChannel", end.getChannel),
            tagger.constant("CHANNEL_UNUSED"), 1,  # frame; of an endless number none can be asked for by its own
        )  # fmt: skip
        self._complete = 0
        self._frame: npt.NDArray[Any] = np.zeros((points, self._bins), np.uint32)
        self._begins: npt.NDArray[Any] = np.zeros(0, np.int64)
        self._ends = self._begins
        self._lost = False

    @property
    def complete(self) -> int:
        return self._complete

    def begin(self) -> None:
        self._tagger.overflowed()
        self._tagger.call("clear", self._flim.clear)
        self._tagger.set("sync")
        self._clock.run(True)

    def look(self) -> int:
        call = self._tagger.call
        if self._tagger.overflowed():
            self._lost = True
        whole = call("getFramesAcquired", self._flim.getFramesAcquired) > 0
        info = (
            call("getReadyFrameEx", self._flim.getReadyFrameEx, 0)
            if whole
            else call("getCurrentFrameEx", self._flim.getCurrentFrameEx)
        )
        self._complete = self._points if whole else int(call("getPixelPosition", info.getPixelPosition))
        frame = self._tagger.read(info, "getHistograms")
        self._frame = frame if frame.shape == (self._points, self._bins) else frame.T
        self._begins, self._ends = (
            self._tagger.read(info, f"getPixel{edge}")[: self.complete] for edge in ("Begins", "Ends")
        )
        return self.complete

    def steps(self) -> tuple[int, int]:
        return steps_by_times(self._begins.tolist(), self._step_ps)

    def lost_points(self) -> int:
        return self.complete if self._lost else 0

    def point(self, k: int) -> Point:
        begun_ps, counts = int(self._begins[k]), self._frame[k, : self._period_bins]
        return Point(counts, begun_ps * PS, (int(self._ends[k]) - begun_ps) / 1e12, self._lost)

    def end(self) -> None:
        self._clock.run(False)
        self._tagger.call("stop", self._flim.stop)


class ByTags:
    """This program sorts: every photon, laser pulse and marker is a tag of `TimeTagStream`."""

    def __init__(self, tagger: Tagger, stepped: Stepped) -> None:
        axis, period, gates, settings = stepped.axis, stepped.period, stepped.gates, stepped.settings
        self._tagger, self._settings, self._period = tagger, settings, period
        self._step_ps, self._width_ps = round(stepped.clock.period_s / PS), round(axis.bin_width_s / PS)
        self._clock, self._dwell_s = stepped.clock, gates.dwells_s[0]
        channels = [settings.sync.channel, settings.detector.channel, *settings.markers]
        self._stream = tagger.measurement("TimeTagStream", _MOST_TAGS, channels)
        dwells = np.full(len(gates.dwells_s), round(gates.dwells_s[0] / PS), np.int64)
        self._markers = StepMarkers(dwells, round(gates.blanking_s / PS), _STEP_MARKERS)
        self._histograms = PointHistograms(len(dwells), period.bins, self._markers, disorder=_DISORDER_PS)
        self._sync_ps = self._until_ps = np.iinfo(np.int64).min // 2

    @property
    def complete(self) -> int:
        return self._histograms.complete

    def begin(self) -> None:
        self._tagger.call("clear", self._stream.clear)
        self._tagger.set("sync")
        self._clock.run(True)

    def look(self) -> int:
        times, channels, lost, until_ps = _tags(self._tagger, self._stream)
        if lost:
            self._histograms.mark_lost(self._until_ps, np.iinfo(np.int64).max)
        if until_ps > self._until_ps:
            self._until_ps = until_ps
            bins, at, self._sync_ps = _photons(times, channels, self._settings, self._sync_ps, self._width_ps)
            bits = np.zeros(len(times), np.uint8)
            for k, channel in enumerate(self._settings.markers):
                bits[channels == channel] = 1 << k
            marked = bits > 0
            self._histograms.add(T3Events(_TAGS, bins, at, bits[marked], times[marked], self._until_ps))
        return self.complete

    def steps(self) -> tuple[int, int]:
        return self._markers.against(self._step_ps)

    def lost_points(self) -> int:
        return int(self._histograms.lost.sum())

    def point(self, k: int) -> Point:
        points, live_s = self._histograms, self._dwell_s * float(self._histograms.exposed[k])
        return Point(points.counts[k], int(points.started[k]) * PS, live_s, bool(points.lost[k]))

    def end(self) -> None:
        self._clock.run(False)
        self._tagger.call("stop", self._stream.stop)


class PointTags:
    """A point that the host starts, sorted here as its tags come: the vendor's buffer drops what finds it full."""

    def __init__(self, tagger: Tagger, settings: TimeTaggerSettings, axis: HistogramAxis, period: Period) -> None:
        self._tagger, self._settings, self._width_ps = tagger, settings, round(axis.bin_width_s / PS)
        self.measurement = tagger.measurement(
            "TimeTagStream", _MOST_TAGS, [settings.sync.channel, settings.detector.channel]
        )
        self.counts: npt.NDArray[Any] = np.zeros(period.bins, np.int64)
        """Over the laser period (bins,)."""
        self.lost = False
        self.begin()

    def begin(self) -> None:
        """What was seen so far is of no point."""
        self.counts = np.zeros_like(self.counts)
        self.lost, self._sync_ps = False, np.iinfo(np.int64).min // 2

    def look(self) -> None:
        """Takes what has come."""
        times, channels, lost, _ = _tags(self._tagger, self.measurement)
        bins, _, self._sync_ps = _photons(times, channels, self._settings, self._sync_ps, self._width_ps)
        self.counts += np.bincount(bins[bins < len(self.counts)], minlength=len(self.counts))
        self.lost |= lost


def _tags(tagger: Tagger, stream: Any) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32], bool, int]:
    """Times in ps and channels (n,) since the last look, whether any were lost - the instrument says so by tags of
    their own, a full buffer not at all - and until when (ps) all are told."""
    buffer = tagger.call("getData", stream.getData)
    kinds = tagger.read(buffer, "getEventTypes")
    whole = kinds == _TIME_TAG
    times = tagger.read(buffer, "getTimestamps").astype(np.int64)
    channels = tagger.read(buffer, "getChannels").astype(np.int32)
    lost = not bool(whole.all()) or len(times) >= _MOST_TAGS
    return times[whole], channels[whole], lost, int(buffer.tGetData)


def _photons(
    times: npt.NDArray[np.int64],
    channels: npt.NDArray[np.int32],
    settings: TimeTaggerSettings,
    sync_ps: int,
    width_ps: int,
) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.int64], int]:
    """Bin after the laser pulse that comes before, and time, of each photon; and the last laser pulse."""
    syncs = np.append(sync_ps, times[channels == settings.sync.channel])
    at = times[channels == settings.detector.channel]
    delays_ps = at - syncs[np.searchsorted(syncs, at, side="right") - 1]
    return np.minimum(delays_ps // width_ps, (1 << 32) - 1).astype(np.uint32), at, int(syncs[-1])
