"""PicoHarp 300, HydraHarp 400 and MultiHarp 150 in histogram mode: one measurement per point."""

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from nlos.drivers.clock import Clock
from nlos.drivers.errors import CommandRejected, DeviceError, LimitError, SyncLost, WrongDevice
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
from nlos.drivers.tcspc.picoquant.families import PicoquantSettings
from nlos.drivers.tcspc.picoquant.library import (
    VendorLibrary,
    check_alive,
    not_in_time,
)
from nlos.drivers.tcspc.picoquant.setup import (
    AxisCodes,
    axis_codes,
    check_sync_rate,
    set_up_inputs,
    set_up_markers,
)
from nlos.drivers.tcspc.time_axis import cannot_stop, nearest_axis
from nlos.drivers.tcspc.unwatched import UnwatchedCounter
from nlos.drivers.tcspc.watched_sleep import sleep_until

MODE_HISTOGRAM, MODE_T3 = 0, 3
_POLL_S = 0.002
_SYNC_LOOK_S = 0.1
"""How often it is asked how many laser pulses come: it counts for as long."""
_MOST_POINTS = 65_536
_SAME_RATE = 0.01


class Picoquant(UnwatchedCounter):
    """A `HistogramCounter`. Points are started by the host; the instrument has neither watchdog nor shutter output."""

    has_pixel_clock = False
    list_mode = False
    counts_markers = False
    max_points = _MOST_POINTS
    warnings: Sequence[str] = ()

    def __init__(self, settings: PicoquantSettings, clock: Clock, library: VendorLibrary, serial: str) -> None:
        self._settings, self._clock, self._library = settings, clock, library
        self._device, self._family = settings.model, library.family
        self._t3 = settings.mode == "t3"
        internal_clock = () if self._family.prefix == "PH" else (0,)
        library.call("Initialize", MODE_T3 if self._t3 else MODE_HISTOGRAM, *internal_clock)
        set_up_inputs(library, settings)
        if self._t3:
            set_up_markers(library, settings)
        resolution_ps, steps = ctypes.c_double(), ctypes.c_int()
        library.call("GetBaseResolution", ctypes.byref(resolution_ps), ctypes.byref(steps))
        self._base_s = resolution_ps.value * 1e-12
        model, part, version = (ctypes.create_string_buffer(64) for _ in range(3))
        library.call("GetHardwareInfo", model, part, version)
        named = (each.value.decode("ascii", "replace") for each in (model, version))
        self.identity = DeviceIdentity(settings.model, "PicoQuant", next(named), serial, next(named))
        self._clock.sleep(self._family.rates_valid_s)
        self._axis: HistogramAxis | None = None
        self._codes: AxisCodes | None = None
        self._dwells_s: Sequence[float] = ()
        self._taken: list[Histogram] = []
        self._triggered = 0
        self._armed_s = self._started_s = self._sync_hz = self._pulses_hz = self._sync_looked_s = 0.0
        self._running = False
        self._compared_hz = (math.inf, 0.0)  # the laser's rate by the divider in use, and by the largest
        self._compare_dividers(self._sync_rate_hz())
        self._meanwhile: Callable[[], None] = lambda: None

    # Settings

    @property
    def follows_mirror(self) -> bool:
        """Only a record of every photon can be sorted by marks."""
        return self._t3

    def check(self, axis: HistogramAxis, dwell_s: float, stop: StopAtCounts | None = None) -> None:
        """Raises `LimitError` where axis or dwell cannot be set exactly. Sends nothing."""
        axis_codes(self._device, self._family, self._base_s, axis, self._t3)
        self._milliseconds(dwell_s)
        if stop is not None:
            raise cannot_stop(self._device)

    def nearest_axis(self, axis: HistogramAxis) -> HistogramAxis:
        widths_s = [self._base_s * 2**code for code in range(self._family.most_binning_codes)]
        return nearest_axis(self._device, axis, widths_s, None if self._t3 else self._family.offset_unit_s)

    def configure(self, axis: HistogramAxis, stop: StopAtCounts | None = None) -> None:
        if stop is not None:
            raise cannot_stop(self._device)
        codes = axis_codes(self._device, self._family, self._base_s, axis, self._t3)
        self._check_sync(self._sync_rate_hz())
        call = self._library.call
        call("SetBinning", codes.binning)
        self._check_taken("bins of {:g} ps", self._library.real("GetResolution"), axis.bin_width_s * 1e12)
        call("SetOffset", codes.offset)
        if not self._t3:
            if self._family.fixed_bins is None:  # what reads them has room for just as many
                taken = self._library.integer("SetHistoLen", codes.length_code)
                self._check_taken("histograms of {:g} bins", taken, codes.length)
            call("SetStopOverflow", 0, ctypes.c_uint(self._family.largest_count))
        self._axis, self._codes = axis, codes

    def arm(self, gates: PointGates) -> None:
        """The instrument knows no point numbers: histograms are told apart by their order since here."""
        gates.check(self._device, self._axis, self.max_points)
        self.abort()
        self._check_trigger(gates)
        self._sync_hz = self._pulses_hz = self.rates().sync_hz
        if self._sync_hz <= 0:
            raise SyncLost(self._device, "sees no sync signal.", "Check laser, sync cable and sync.level_mv.")
        self._check_sync(self._sync_hz)
        self._dwells_s, self._taken, self._triggered = gates.dwells_s, [], 0
        self._armed_s = self._sync_looked_s = self._clock.now()

    def _check_sync(self, sync_hz: float) -> None:
        """Raises `LimitError` where laser and sync divider do not go together."""
        if sync_hz > 0:  # else there is no laser yet: `arm` says so
            self._compare_dividers(sync_hz)
            seen_hz = max(sync_hz, self._compared_hz[1])
            check_sync_rate(self._device, self._family, self._settings.sync_divider, seen_hz)

    def _compare_dividers(self, sync_hz: float) -> None:
        """Pulses that the sync input is too slow for need not show on its rate meter: once for each rate of the laser
        it is held against the largest divider's."""
        divider, largest = self._settings.sync_divider, self._family.sync_dividers[-1]
        if sync_hz <= 0 or divider == largest or abs(sync_hz / self._compared_hz[0] - 1) <= _SAME_RATE:
            return
        rates_hz = [sync_hz]
        for each in (largest, divider):
            self._library.call("SetSyncDiv", each)
            self._clock.sleep(self._family.rates_valid_s)
            rates_hz.append(self._sync_rate_hz())
        self._compared_hz = sync_hz, max(rates_hz)

    def _check_taken(self, what: str, taken: float, asked: float) -> None:
        if abs(taken - asked) > 1e-6 * asked:
            raise WrongDevice(
                self._device,
                f"it took {what.format(taken)} where {what.format(asked)} were asked for.",
                f"Its library counts otherwise than this adapter: install {self._family.package}.",
            )

    def _check_trigger(self, gates: PointGates) -> None:
        if gates.trigger is not Trigger.HOST:
            raise LimitError(
                self._device,
                "in histogram mode every point is started by the host.",
                "Set mode: t3 in the bench file for scans stepped by a clock.",
            )
        for dwell_s in set(gates.dwells_s):
            self._milliseconds(dwell_s)

    def _milliseconds(self, dwell_s: float) -> int:
        """How long a measurement of one point lasts. Raises `LimitError` where that is not what was asked for."""
        whole = round(dwell_s * 1e3)
        if not 1 <= whole <= 360_000_000 or abs(dwell_s * 1e3 - whole) > 1e-6:
            raise LimitError(
                self._device,
                f"dwell {dwell_s * 1e3:g} ms is not a whole number of milliseconds.",
                f"Set dwell_ms to {max(whole, 1)}, or `mode: t3` in the bench file.",
            )
        return whole

    # Acquiring

    def trigger(self) -> None:
        if self._running or self._triggered >= len(self._dwells_s):
            raise CommandRejected(self._device, "no armed point is left to trigger.", "Arm again.")
        self._begin(self._milliseconds(self._dwells_s[self._triggered]))
        self._triggered += 1

    def _begin(self, milliseconds: int) -> None:
        if not self._t3:
            self._library.call("ClearHistMem", *((0,) if self._family.prefix == "PH" else ()))
        self._library.call("StartMeas", milliseconds)
        self._running, self._started_s = True, self._clock.now()

    def wait_points(self, count: int, timeout_s: float) -> CounterStatus:
        deadline_s = self._clock.now() + timeout_s
        while len(self._taken) < count:
            if not self._running:
                raise CommandRejected(self._device, f"{count} points wanted, {self._triggered} triggered.", "Trigger.")
            due_s = self._started_s + self._dwells_s[self._triggered - 1]
            sleep_until(self._clock, min(due_s, deadline_s), self._while_running)
            while not self._library.integer("CTCStatus"):
                if self._clock.now() >= deadline_s:
                    self._stop()
                    raise not_in_time(self._library, f"{len(self._taken)} of {count} points complete", timeout_s)
                self._while_running()
                self._clock.sleep(_POLL_S)
            self._taken.append(self._finish())
        return CounterStatus(False, len(self._taken), 0, None)

    def rest(self, seconds: float) -> bool:
        if self._running and not self._library.integer("CTCStatus"):
            sleep_until(self._clock, self._clock.now() + seconds, self._while_running)
            return True
        return False

    def meanwhile(self, look: Callable[[], None]) -> None:
        self._meanwhile = look

    def _while_running(self) -> int:
        """What has to be done while a point is being measured; how much of it there was."""
        self._meanwhile()
        self._flags()
        return 0

    def _finish(self) -> Histogram:
        """Stops, which is needed even though the time has expired, and reads."""
        self._stop()
        axis, codes = self._configured()
        live_s = self._library.real("GetElapsedMeasTime") * 1e-3 or self._dwells_s[self._triggered - 1]
        buffer = (ctypes.c_uint * codes.length)()
        which = {"PH": (0,), "HH": (self._settings.channel, 0), "MH": (self._settings.channel,)}[self._family.prefix]
        self._library.call("GetHistogram", buffer, *which)
        counts = np.ctypeslib.as_array(buffer)
        return self._histogram(counts[: axis.bins].copy(), int(counts.sum(dtype=np.uint64)), live_s, self._flags())

    def _histogram(self, counts: Any, total: int, live_s: float, flags: HistogramFlag) -> Histogram:
        axis, _ = self._configured()
        opened_s = self._started_s - self._armed_s
        if flags & HistogramFlag.DATA_LOST:  # how many photons were lost is not known: none count
            return Histogram(np.zeros_like(counts), axis.bin_width_s, axis.offset_s, 0.0, 0, 0, flags, opened_s)
        pulses = round(self._pulses_hz * live_s)
        return Histogram(counts, axis.bin_width_s, axis.offset_s, live_s, pulses, total, flags, opened_s)

    def _flags(self) -> HistogramFlag:
        """The instrument's flags in ours. Raises `DeviceFault` and `SyncLost`."""
        family, raw = self._family, self._library.integer("GetFlags")
        check_alive(self._library, raw, "while measuring")
        self._look_at_sync()
        if raw & family.sync_lost or self._pulses_hz <= 0:
            raise SyncLost(self._device, "lost the sync signal.", "Check laser and sync cable.")
        flags = HistogramFlag.NONE
        if raw & family.overflow:
            flags |= HistogramFlag.SATURATED
        if raw & (family.counts_dropped | (family.fifo_full if self._t3 else 0)):
            flags |= HistogramFlag.DATA_LOST
        return flags

    def _look_at_sync(self) -> None:
        """A laser that changes its rate in the middle of a scan shows in the pulses of the points that follow."""
        if self._clock.now() - self._sync_looked_s >= _SYNC_LOOK_S:
            self._sync_looked_s, self._pulses_hz = self._clock.now(), self._sync_rate_hz()

    def read(self, first: int, count: int) -> list[Histogram]:
        if not 0 <= first <= first + count <= len(self._taken):
            raise CommandRejected(self._device, f"points {first} to {first + count - 1} are not complete.", "Wait.")
        return self._taken[first : first + count]

    def abort(self) -> None:
        if self._running:
            self._stop()

    def _stop(self) -> None:
        self._library.call("StopMeas")
        self._running = False

    def rates(self) -> CountRates:
        channel = 1 if self._family.prefix == "PH" else self._settings.channel
        return CountRates(self._sync_rate_hz(), float(self._library.integer("GetCountRate", channel)))

    def _sync_rate_hz(self) -> float:
        """The laser's, whatever the divider: the library corrects for it."""
        asked = ("GetCountRate", 0) if self._family.prefix == "PH" else ("GetSyncRate",)
        return float(self._library.integer(*asked))

    def close(self) -> None:
        try:
            self.abort()
        except DeviceError:
            pass  # closing must succeed whatever state the link is in
        finally:
            self._library.let_go()

    def _configured(self) -> tuple[HistogramAxis, AxisCodes]:
        if self._axis is None or self._codes is None:
            raise LimitError(self._device, "no time axis was set.", "Call configure() first.")
        return self._axis, self._codes
