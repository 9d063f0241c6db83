"""A Swabian Time Tagger: points started by the host, each one `Histogram` of the vendor's; see `clocked.py` for scans.

What is histogrammed is the whole laser period, so that the photons outside the axis are counted too.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from nlos.drivers.clock import Clock
from nlos.drivers.device_model import WireLog
from nlos.drivers.errors import CommandRejected, DeviceError, DeviceTimeout, LimitError
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.tcspc.counter import (
    CounterStatus,
    CountRates,
    Histogram,
    HistogramAxis,
    HistogramFlag,
    PointGates,
    StopAtCounts,
    Trigger,
)
from nlos.drivers.tcspc.time_axis import cannot_stop, nearest_whole_ps
from nlos.drivers.tcspc.timetagger.clocked import ByFlim, ByTags, Clocked, Period, PixelClock, PointTags, Stepped
from nlos.drivers.tcspc.timetagger.settings import TimeTaggerSettings
from nlos.drivers.tcspc.timetagger.tagger import PS, Tagger, load_package
from nlos.drivers.tcspc.unwatched import UnwatchedCounter
from nlos.drivers.tcspc.watched_sleep import sleep_until

_MOST_POINTS = 65_536
_MOST_BINS = 1 << 20
_LONGEST_S = 3600.0
_POLL_S = 0.002
_WATCH_S = 0.01


class TimeTagger(UnwatchedCounter):
    """A `HistogramCounter` without watchdog or shutter output. With `pixel_clock` it steps the mirror and sorts photons
    by the mirror's markers."""

    max_points = _MOST_POINTS

    def __init__(self, settings: TimeTaggerSettings, clock: Clock, tagger: Tagger) -> None:
        self._settings, self._clock, self.tagger = settings, clock, tagger
        self._device = settings.model
        self.has_pixel_clock, self.follows_mirror = settings.pixel_clock is not None, settings.mirror_steps
        self.list_mode = self.counts_markers = self.has_pixel_clock or self.follows_mirror
        self.warnings: Sequence[str] = ()
        for each in (settings.sync, settings.detector):
            tagger.set_level(each.channel, each.level_mv)
        tagger.delay_inputs()
        for channel in settings.markers if self.counts_markers else ():
            tagger.set_level(channel, settings.marker_level_mv)
        if settings.pixel_clock is not None:
            tagger.set("xtra_setAuxOut", settings.pixel_clock, False)  # a model or licence without it says so here
        self.identity = DeviceIdentity(
            settings.model,
            "Swabian Instruments",
            *(str(tagger.set(f"get{what}")) for what in ("Model", "Serial", "FirmwareVersion")),
        )
        self._axis: HistogramAxis | None = None
        self._period = Period(0.0, 0, 0)
        self._histogram: Any = None
        self._tags: PointTags | None = None
        self._clocked: Clocked | None = None
        self._dwells_s: Sequence[float] = ()
        self._taken: list[Histogram] = []
        self._triggered = 0
        self._armed_s = self._started_s = 0.0
        self._zero_s: float | None = None
        """Of the instrument's own time, when it was armed; its tags count from when it was opened."""
        self._running = False
        self._meanwhile: Callable[[], None] = lambda: None

    @classmethod
    def open(
        cls, settings: TimeTaggerSettings, clock: Clock, backend: Any = None, wire_log: WireLog | None = None
    ) -> "TimeTagger":
        """Loads the vendor's package, finds the instrument and sets it up; `backend` replaces the package.

        Raises `DeviceNotFound`, `DeviceBusy`, or what the package reports.
        """
        tagger = Tagger(settings, clock, load_package(settings.model) if backend is None else backend, wire_log)
        try:
            return cls(settings, clock, tagger)
        except BaseException:
            tagger.close()
            raise

    # Settings

    def check(self, axis: HistogramAxis, dwell_s: float, stop: StopAtCounts | None = None) -> None:
        width, first = axis.bin_width_s / PS, axis.offset_s / axis.bin_width_s
        if abs(width - round(width)) > 1e-3 or round(width) < 1:
            raise LimitError(
                self._device, f"bin width {width:g} ps is not a whole number of ps.", "Change histogram.bin_width_ps."
            )
        if abs(first - round(first)) > 1e-3 or not 0 <= round(first) < round(first) + axis.bins <= _MOST_BINS:
            raise LimitError(
                self._device,
                f"{axis.bins} bins from {axis.offset_s * 1e9:g} ns are not whole bins among {_MOST_BINS}.",
                "Choose fewer bins, or an offset that is a multiple of the bin width.",
            )
        if not 1e-6 <= dwell_s <= _LONGEST_S:
            raise LimitError(self._device, f"dwell {dwell_s:g} s is not 1 us to {_LONGEST_S:g} s.", "Change dwell_ms.")
        if stop is not None:
            raise cannot_stop(self._device)

    def nearest_axis(self, axis: HistogramAxis) -> HistogramAxis:
        return nearest_whole_ps(axis)

    def configure(self, axis: HistogramAxis, stop: StopAtCounts | None = None) -> None:
        self.check(axis, 1.0, stop)
        self._axis, self._histogram = axis, None

    def arm(self, gates: PointGates) -> None:
        """The instrument knows no point numbers: histograms are told apart by their order since here. The laser's rate
        is measured, which says how many bins a period has."""
        axis = gates.check(self._device, self._axis, self.max_points)
        dwells_s, trigger, blanking_s = gates.dwells_s, gates.trigger, gates.blanking_s
        for dwell_s in set(dwells_s):
            self.check(axis, dwell_s)
        self.abort()
        if trigger is Trigger.CLOCK and not self.has_pixel_clock:
            raise LimitError(
                self._device,
                "no AUX OUT steps the mirror.",
                "Name one as `pixel_clock`, or scan point by point.",
            )
        if trigger is Trigger.MIRROR and not self.follows_mirror:
            raise LimitError(self._device, "no marks of the mirror are wired to it.", "Set mirror_steps: true.")
        if trigger is not Trigger.HOST and len(set(dwells_s)) != 1:
            raise LimitError(self._device, "points stepped by a clock have one dwell.", "Use a uniform dwell.")
        sync_hz = self.tagger.laser_hz()
        self.tagger.filter_sync(sync_hz)
        width_ps, first = round(axis.bin_width_s / PS), round(axis.offset_s / axis.bin_width_s)
        bins = max(first + axis.bins, -(-round(1 / (sync_hz * PS)) // width_ps))
        self._period = Period(sync_hz, first, bins)
        self._dwells_s, self._taken, self._triggered = dwells_s, [], 0
        self._armed_s, self._zero_s = self._clock.now(), None
        if trigger is not Trigger.HOST:
            kind: type[ByTags | ByFlim] = ByTags if self._settings.mode == "list" else ByFlim
            step_s = gates.step_s or dwells_s[0] + blanking_s
            clock = PixelClock(self.tagger, self._settings.pixel_clock if trigger is Trigger.CLOCK else None, step_s)
            made = kind(self.tagger, Stepped(self._settings, axis, self._period, gates, clock))
            self._clocked = made
            self._running = True
            self._clocked.begin()
            return
        sync, detector = self._settings.sync.channel, self._settings.detector.channel
        self._tags = None
        if self._settings.mode == "list":
            self._tags = PointTags(self.tagger, self._settings, axis, self._period)
            self._histogram = self._tags.measurement
        else:
            self._histogram = self.tagger.measurement("Histogram", detector, sync, width_ps, bins)
        self.tagger.call("stop", self._histogram.stop)

    # Acquiring

    def trigger(self) -> None:
        if self._running or self._triggered >= len(self._dwells_s) or self._clocked is not None:
            raise CommandRejected(self._device, "no armed point is left to trigger.", "Arm again.")
        dwell_ps = round(self._dwells_s[self._triggered] / PS)
        self._started_s = self._clock.now()
        if self._tags is not None:
            self._tags.begin()
        self.tagger.call("startFor", self._histogram.startFor, dwell_ps)
        self._running = True
        self._triggered += 1

    def wait_points(self, count: int, timeout_s: float) -> CounterStatus:
        deadline_s = self._clock.now() + timeout_s
        clocked = self._clocked
        if clocked is not None:
            while self._running and clocked.look() < count:
                self._meanwhile()
                if self._clock.now() >= deadline_s:
                    self.abort()
                    raise self._late(f"{clocked.complete} of {count} points complete", timeout_s)
                self._clock.sleep(min(_WATCH_S, deadline_s - self._clock.now()))
            done = clocked.complete
            if self._zero_s is None and done:  # what its own time was when it was armed, to within a look and a step
                self._zero_s = (
                    clocked.point(done - 1).opened_s + self._dwells_s[done - 1] - (self._clock.now() - self._armed_s)
                )
            if done >= len(self._dwells_s) and self._running:
                self._end()
                self._check_sync()
            seen, due = clocked.steps()
            return CounterStatus(self._running, done, clocked.lost_points(), seen, due)
        while len(self._taken) < count:
            if not self._running:
                raise CommandRejected(self._device, f"{count} points wanted, {self._triggered} triggered.", "Trigger.")
            due_s = self._started_s + self._dwells_s[self._triggered - 1]
            sleep_until(self._clock, min(due_s, deadline_s), self._while_running)
            while self.tagger.call("isRunning", self._histogram.isRunning):
                if self._clock.now() >= deadline_s:
                    self.abort()
                    raise self._late(f"{len(self._taken)} of {count} points complete", timeout_s)
                self._while_running()
                self._clock.sleep(_POLL_S)
            self._taken.append(self._finish())
            if len(self._taken) == len(self._dwells_s):
                self._check_sync()
        return CounterStatus(False, len(self._taken), 0, None)

    def _check_sync(self) -> None:
        """Before the last points are read. Raises `SyncLost`."""
        self.tagger.check_sync(self._period.sync_hz, round(self._configured().bin_width_s / PS))

    def _late(self, what: str, timeout_s: float) -> DeviceTimeout:
        return DeviceTimeout(self._device, f"{what} after {timeout_s:g} s.", "Check clock and marker wiring.")

    def rest(self, seconds: float) -> bool:
        if self._clocked is None and self._running and self.tagger.call("isRunning", self._histogram.isRunning):
            sleep_until(self._clock, self._clock.now() + seconds, self._while_running)
            return True
        return False

    def _while_running(self) -> None:
        self._meanwhile()
        if self._tags is not None:
            self._tags.look()

    def meanwhile(self, look: Callable[[], None]) -> None:
        self._meanwhile = look

    def _finish(self) -> Histogram:
        self._running = lost = False
        if self._tags is not None:
            self._tags.look()
            counts, lost = self._tags.counts, self._tags.lost
        else:
            counts = self.tagger.read(self._histogram).astype(np.uint32)
        live_s = self._dwells_s[self._triggered - 1]
        flags = HistogramFlag.DATA_LOST if self.tagger.overflowed() or lost else HistogramFlag.NONE
        return self._made(counts, live_s, flags, self._started_s - self._armed_s)

    def _made(self, counts: Any, live_s: float, flags: HistogramFlag, opened_s: float) -> Histogram:
        """From the counts of a whole laser period, shape (period.bins,)."""
        axis, period = self._configured(), self._period
        if flags & HistogramFlag.DATA_LOST:  # how many photons were lost is not known: none count
            counts, live_s = np.zeros_like(counts), 0.0
        inside = counts[period.first : period.first + axis.bins].astype(np.uint32)
        pulses, total = round(live_s * period.sync_hz), int(counts.sum())
        return Histogram(inside, axis.bin_width_s, axis.offset_s, live_s, pulses, total, flags, opened_s)

    def read(self, first: int, count: int) -> list[Histogram]:
        clocked = self._clocked
        if clocked is None:
            if not 0 <= first <= first + count <= len(self._taken):
                raise CommandRejected(self._device, f"points {first} to {first + count - 1} are not complete.", "Wait.")
            return self._taken[first : first + count]
        if not 0 <= first <= first + count <= clocked.complete:
            raise CommandRejected(self._device, f"points {first} to {first + count - 1} are not complete.", "Wait.")
        taken = []
        for point in range(first, first + count):
            seen = clocked.point(point)
            flags = HistogramFlag.DATA_LOST if seen.lost else HistogramFlag.NONE
            taken.append(self._made(seen.counts, seen.live_s, flags, seen.opened_s - (self._zero_s or 0.0)))
        return taken

    def _end(self) -> None:
        self._running = False
        if self._clocked is not None:
            self._clocked.end()

    def abort(self) -> None:
        if self._running and self._clocked is None:
            self.tagger.call("stop", self._histogram.stop)
        self._end()
        self._clocked, self._triggered, self._dwells_s, self._taken = None, 0, (), []

    def rates(self) -> CountRates:
        """While points are taken, laser pulses pass a filter: then their rate is the one that was measured before."""
        if self._running:
            return CountRates(self._period.sync_hz, self.tagger.detector_hz())
        return self.tagger.rates()

    def close(self) -> None:
        if self.tagger.closed:
            return
        try:
            self.abort()
        except DeviceError:
            pass  # closing must succeed whatever state the link is in
        finally:
            self.tagger.close()

    def _configured(self) -> HistogramAxis:
        if self._axis is None:
            raise LimitError(self._device, "no time axis was set.", "Call configure() first.")
        return self._axis
