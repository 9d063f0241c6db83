"""The same instruments in T3 mode: every photon with its time, sorted into points by the mirror's markers."""

import ctypes
import math

import numpy as np
import numpy.typing as npt

from nlos.drivers.clock import Clock
from nlos.drivers.errors import DeviceTimeout, LimitError
from nlos.drivers.tcspc.counter import CounterStatus, Histogram, HistogramFlag, PointGates, Trigger
from nlos.drivers.tcspc.picoquant.families import PicoquantSettings
from nlos.drivers.tcspc.picoquant.histogram import Picoquant
from nlos.drivers.tcspc.picoquant.library import VendorLibrary, not_in_time
from nlos.drivers.tcspc.t3 import T3Decoder
from nlos.drivers.tcspc.t3_points import PointHistograms, StepMarkers

_CLOCK_UNIT_S = 100e-9
_LONGEST_PERIOD = 16_777_215
_LONGEST_MS = 360_000_000
_POLL_S = 0.002
"""ReadFiFo returns within about 10 ms; asked more often it returns less."""
_EMPTIED_WITHIN_S = 1.0
"""After a point: what waits in the FIFO then is milliseconds of photons. Light may be on meanwhile."""
_STEP_MARKERS = 0b011


class PicoquantT3(Picoquant):
    """Scans stepped by the MultiHarp's trigger output, or points started by the host; in both cases from records.

    The trigger output steps the mirror, whose marker outputs come back into the record stream.
    """

    list_mode = True
    counts_markers = True

    def __init__(self, settings: PicoquantSettings, clock: Clock, library: VendorLibrary, serial: str) -> None:
        super().__init__(settings, clock, library, serial)
        self.has_pixel_clock = library.family.trigger_output
        self._buffer = (ctypes.c_uint * library.family.most_fifo_records)()
        self._decoder = T3Decoder(library.family.layout)
        self._points: PointHistograms | None = None
        self._markers: StepMarkers | None = None
        self._period_s = 0.0
        self._last_pulse = math.inf
        self._all_flags = HistogramFlag.NONE
        self._single = (np.zeros(0, dtype=np.int64), 0)

    def _check_trigger(self, gates: PointGates) -> None:
        self._points = self._markers = None
        if gates.trigger is Trigger.HOST:
            super()._check_trigger(gates)
            return
        if gates.trigger is Trigger.MIRROR:
            return
        if not self.has_pixel_clock:
            raise LimitError(self._device, "it has no trigger output to step the mirror.", "Scan point by point.")
        if len(set(gates.dwells_s)) != 1:
            raise LimitError(self._device, "its clock has one period for all points.", "Use a uniform dwell.")
        period = (gates.dwells_s[0] + gates.blanking_s) / _CLOCK_UNIT_S
        if abs(period - round(period)) > 1e-3 or not 1 <= round(period) <= _LONGEST_PERIOD:
            raise LimitError(
                self._device,
                f"dwell and blanking make {period * _CLOCK_UNIT_S * 1e3:g} ms, no multiple of 100 ns up to 1.677 s.",
                "Change dwell_ms.",
            )

    def _milliseconds(self, dwell_s: float) -> int:
        """Measurements are whole milliseconds, points any number of laser pulses at the beginning of one."""
        whole = math.ceil(dwell_s * 1e3 - 1e-6)
        if not dwell_s > 0 or not 1 <= whole <= _LONGEST_MS:
            raise LimitError(self._device, f"dwell {dwell_s * 1e3:g} ms is not within 0 to 100 h.", "Change dwell_ms.")
        return whole

    def arm(self, gates: PointGates) -> None:
        """As `Picoquant.arm`. With `Trigger.CLOCK` the trigger output steps the mirror from now on; with
        `Trigger.MIRROR` the mirror's marks are only waited for."""
        super().arm(gates)
        axis, codes = self._configured()
        self._all_flags = HistogramFlag.NONE
        if gates.trigger is Trigger.HOST:
            return
        dwells_s, blanking_s = gates.dwells_s, gates.blanking_s
        self._period_s = gates.step_s or dwells_s[0] + blanking_s
        dwells = np.round(np.asarray(dwells_s) * self._sync_hz).astype(np.int64)
        self._markers = StepMarkers(dwells, round(blanking_s * self._sync_hz), _STEP_MARKERS)
        self._points = PointHistograms(
            len(dwells_s),
            axis.bins,
            self._markers,
            first_bin=codes.first,
            channel=self._settings.channel if self._family.prefix != "PH" else None,
            disorder=round(self._settings.marker_disorder_us * 1e-6 * self._sync_hz),
        )
        self._decoder = T3Decoder(self._family.layout)
        self._begin(round((len(dwells_s) + 2) * self._period_s * 1e3) + 1000)
        if gates.trigger is Trigger.CLOCK:
            self._library.call("SetTriggerOutput", round(self._period_s / _CLOCK_UNIT_S))

    def wait_points(self, count: int, timeout_s: float) -> CounterStatus:
        if self._points is None:
            return super().wait_points(count, timeout_s)
        deadline_s = self._clock.now() + timeout_s
        while self._points.complete < count and self._running:
            self._while_running()
            if self._points.complete >= count:
                break
            if self._clock.now() >= deadline_s:
                self._stop()
                raise not_in_time(self._library, f"{self._points.complete} of {count} points complete", timeout_s)
            self._clock.sleep(min(_POLL_S, deadline_s - self._clock.now()))
        done = self._points.complete if self._running else len(self._dwells_s)
        if done >= len(self._dwells_s):
            self.abort()
        assert self._markers is not None
        seen, due = self._markers.against(self._period_s * self._sync_hz)
        return CounterStatus(self._running, done, int(self._points.lost.sum()), seen, due)

    def _begin(self, milliseconds: int) -> None:
        self._single = (np.zeros(self._axis.bins if self._axis else 0, dtype=np.int64), 0)
        if self._points is None:
            self._decoder = T3Decoder(self._family.layout)
            dwell_s = self._dwells_s[self._triggered]
            cut = milliseconds * 1e-3 - dwell_s > 1e-9
            self._last_pulse = dwell_s * self._sync_hz if cut else math.inf
        super()._begin(milliseconds)

    def _while_running(self) -> int:
        """Reads from the FIFO, and sees whether it was full: then what follows is not in step with time any more."""
        self._meanwhile()
        records = self._read_fifo()
        events = self._decoder.feed(records)
        flags = self._flags()
        self._all_flags |= flags
        if self._points is None:
            delays = events.format.delays(events.photons)
            exposed = events.photon_pulses < self._last_pulse
            if self._family.prefix != "PH":
                exposed &= events.format.channels(events.photons) == self._settings.channel
            delays = delays[exposed]
            axis, codes = self._configured()
            # Delays before the first bin wrap to large numbers and fall out with those after the last.
            wanted = np.minimum(delays - np.uint32(codes.first), np.uint32(axis.bins))
            counts = self._single[0] + np.bincount(wanted, minlength=axis.bins + 1)[: axis.bins]
            self._single = (counts, self._single[1] + len(delays))
            return len(records)
        self._points.add(events)
        if flags & HistogramFlag.DATA_LOST:
            self._points.mark_lost(events.until_pulse, np.iinfo(np.int64).max)
            self._points.lost[self._points.complete :] = True
            self._stop()
        return len(records)

    def _read_fifo(self) -> npt.NDArray[np.uint32]:
        count = (self._family.most_fifo_records,) if self._family.fifo_takes_count else ()
        read = self._library.integer("ReadFiFo", self._buffer, *count)
        return np.ctypeslib.as_array(self._buffer)[:read].copy()

    def _finish(self) -> Histogram:
        """One point started by the host: what is still in the FIFO belongs to it, up to the end of its dwell."""
        until_s = self._clock.now() + _EMPTIED_WITHIN_S
        while self._while_running():
            if self._clock.now() >= until_s:
                self._stop()
                raise DeviceTimeout(
                    self._device, f"photons still come {_EMPTIED_WITHIN_S:g} s after the end of a point."
                )
        self._stop()
        dwell_s = self._dwells_s[self._triggered - 1]
        live_s = min(self._library.real("GetElapsedMeasTime") * 1e-3 or dwell_s, dwell_s)
        flags, self._all_flags = self._all_flags, HistogramFlag.NONE
        return self._histogram(self._single[0].astype(np.uint32), self._single[1], live_s, flags)

    def read(self, first: int, count: int) -> list[Histogram]:
        points = self._points
        if points is None:
            return super().read(first, count)
        axis, _ = self._configured()
        taken = []
        for point in range(first, first + count):
            lost = bool(points.lost[point]) or point >= points.complete
            live_s = 0.0 if lost else self._dwells_s[point] * float(points.exposed[point])
            taken.append(
                Histogram(
                    np.zeros_like(points.counts[point]) if lost else points.counts[point].copy(),
                    axis.bin_width_s,
                    axis.offset_s,
                    live_s,
                    round(live_s * self._pulses_hz),
                    0 if lost else int(points.totals[point]),
                    HistogramFlag.DATA_LOST if lost else HistogramFlag.NONE,
                    points.started[point] / self._sync_hz,
                )
            )
        return taken

    def _stop(self) -> None:
        if self.has_pixel_clock:
            self._library.call("SetTriggerOutput", 0)
        super()._stop()
