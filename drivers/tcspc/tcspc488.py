"""The `tcspc488` histogrammer: points armed in one go, gated one by one or by the pixel clock, read while others run.

In scheme S1 one question per point both confirms that its gate has closed and brings its record; the record is
checked in `read`, while the mirror moves on.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate
from typing import Any, NoReturn

from drivers.clock import Clock
from drivers.errors import (
    CommandRejected,
    DeviceError,
    DeviceReset,
    DeviceTimeout,
    LimitError,
)
from drivers.identity import DeviceIdentity
from drivers.link.scpi import ErrorsReported, Scpi, ScpiError
from drivers.link.usb488 import Usb488
from drivers.link.usbtmc import UsbtmcInterface, WireLog, find_usb
from drivers.tcspc.counter import (
    CounterStatus,
    CountRates,
    Histogram,
    HistogramAxis,
    StopAtCounts,
    Trigger,
)
from drivers.tcspc.tcspc488_messages import (
    Capacity,
    Status,
    arm_commands,
    axis_commands,
    decode_capacity,
    decode_identity,
    decode_status,
    is_trip,
    microseconds,
    safety_error,
    stop_commands,
)
from drivers.tcspc.tcspc488_reading import checked, read_records
from drivers.tcspc.tcspc488_records import record_bytes
from drivers.tcspc.tcspc488_settings import Tcspc488Settings, input_commands
from drivers.tcspc.tcspc488_setup import Setup
from drivers.tcspc.tcspc488_shutter import Tcspc488Shutter

__all__ = ["Tcspc488", "Tcspc488Settings", "Tcspc488Shutter"]

_SHORT_WAIT_S = 0.01
_EARLY_S = 0.002
"""How often a gate that may end early is looked at."""
_NOT_READY, _OVERRUN = -230, 104
_POLL_S = 0.05
"""Longest time between two looks at the status: a lost service request costs no more (20 Hz)."""


class Tcspc488:
    """A `HistogramCounter`. Made by `Tcspc488.open`."""

    has_pixel_clock = True
    has_watchdog = True
    list_mode = False

    def __init__(self, settings: Tcspc488Settings, clock: Clock, link: Usb488, scpi: Scpi) -> None:
        self.warnings: list[str] = []
        self.shutter_opened = False
        self._device = settings.model
        self._settings = settings
        self.clock = clock
        self.link = link
        self.scpi = scpi
        self.identity: DeviceIdentity = decode_identity(settings.model, scpi.query(b"*IDN?")[0])
        self._capacity: Capacity = decode_capacity(settings.model, scpi.query(b"SYST:CAPS?")[0])
        self._wide = settings.counts == "u32"
        self._axis: HistogramAxis | None = None
        self._stops = False
        self._numbers: Sequence[int] = ()
        self._due_s: list[float] = []
        self._dwells_s: Sequence[float] = ()
        self._trigger = Trigger.HOST
        self._triggered = 0
        self._gate_due_s = 0.0
        self._brought: tuple[int, memoryview] | None = None
        self._watchdog_s = 0.0
        self._kicked_s = 0.0
        self._trip_reported = False
        self._setup = Setup(settings.model, scpi, self.identity)
        self._setup.apply(input_commands(settings))

    @classmethod
    def open(
        cls, settings: Tcspc488Settings, clock: Clock, backend: Any = None, wire_log: WireLog | None = None
    ) -> "Tcspc488":
        """Finds, opens, clears and configures the instrument; nothing is armed, the shutter is left as it is.

        Raises `DeviceNotFound`, `DeviceBusy`, `WrongDevice` or what the link meets.
        """
        if settings.usb == "simulated" and backend is None:
            raise LimitError(settings.model, "usb: simulated needs the simulated bench.", "Open it by its bench file.")
        serial = None if settings.usb in ("simulated", "auto") else settings.usb
        found = find_usb(settings.model, settings.vendor_id, settings.product_id, serial, backend)
        link = Usb488(UsbtmcInterface(settings.model, found, wire_log), clock)
        try:
            scpi = Scpi(settings.model, link, settings.timeout_s)
            scpi.drain_errors()
            scpi.command(b"ABOR")  # whatever an earlier program left running
            return cls(settings, clock, link, scpi)
        except DeviceError:
            link.close()
            raise

    # Settings

    @property
    def counts_markers(self) -> bool:
        return self._settings.markers

    @property
    def max_points(self) -> int:
        return self._capacity.max_points

    def check(self, axis: HistogramAxis, dwell_s: float) -> None:
        """Raises `LimitError` where axis or dwell cannot be set exactly. Sends nothing."""
        axis_commands(self._device, axis, self._capacity)
        microseconds(self._device, dwell_s)

    def configure(self, axis: HistogramAxis, stop: StopAtCounts | None = None) -> None:
        commands = axis_commands(self._device, axis, self._capacity) | stop_commands(self._device, axis, stop)
        with self._errors_named():
            self._setup.apply(commands)
        self._axis, self._stops = axis, stop is not None

    def arm(
        self,
        dwells_s: Sequence[float],
        numbers: Sequence[int],
        trigger: Trigger = Trigger.HOST,
        blanking_s: float = 0.0,
    ) -> None:
        """Gets ready for the points; every setting is read back before the instrument is started."""
        if self._axis is None:
            raise LimitError(self._device, "armed before a time axis was set.", "Call configure() first.")
        if len(dwells_s) != len(numbers) or not 1 <= len(dwells_s) <= self.max_points:
            raise LimitError(
                self._device,
                f"{len(dwells_s)} dwells and {len(numbers)} numbers; both must be 1 to {self.max_points} of the same.",
            )
        dwells_us = [microseconds(self._device, each) for each in dwells_s]
        blanking_us = microseconds(self._device, blanking_s) if blanking_s else 0
        commands, lists = arm_commands(dwells_us, trigger, blanking_us, self._stops)
        lists["ACQ:NUMB:LIST"] = list(numbers)
        with self._errors_named():
            self.scpi.command(b"ABOR")
            self._setup.apply(commands, lists)
            if self._setup.restore(lists):
                self._restarted()
            self.scpi.command(b"INIT", retry=False)
        self._dwells_s, self._numbers, self._trigger = dwells_s, numbers, trigger
        self._triggered, self._brought, self._trip_reported = 0, None, False
        start_s = self.clock.now()
        self._due_s = [start_s + each for each in accumulate((us + blanking_us) * 1e-6 for us in dwells_us)]

    def _restarted(self) -> None:
        """The instrument lost its settings, and has them back. A shutter of its own has closed, though."""
        if self.shutter_opened:
            raise DeviceReset(self._device, "it restarted, which closed the shutter.", "Its settings are back: resume.")
        self.warnings.append("the counter restarted between two acquisitions; its settings were sent again")
        if self._watchdog_s:
            self.arm_watchdog(self._watchdog_s)

    # Acquiring

    def trigger(self) -> None:
        if self._triggered >= len(self._numbers):
            raise CommandRejected(self._device, f"all {len(self._numbers)} armed points are triggered.", "Arm again.")
        self.link.trigger(self.scpi.timeout_s)
        self._gate_due_s = self.clock.now() + self._dwells_s[self._triggered]
        self._triggered += 1

    def wait_points(self, count: int, timeout_s: float) -> CounterStatus:
        deadline_s = self.clock.now() + timeout_s
        by_host = self._trigger is Trigger.HOST
        due_s = self._gate_due_s if by_host else self._due_s[min(count, len(self._due_s)) - 1]
        again_s = 0.0005
        look_s = self.clock.now() + _EARLY_S if self._stops else due_s
        while True:
            self._pause(min(due_s, look_s, deadline_s))
            now_s = self.clock.now()
            wanted = count - 1 if by_host and now_s >= min(due_s, look_s) else None
            status = self._poll(wanted)
            if status.state in ("TRIP", "FAULT"):
                self._tripped(())
            if status.done >= count:
                return CounterStatus(status.running, status.done, status.lost, status.markers)
            if status.state == "IDLE":
                raise DeviceReset(self._device, f"it is idle after {status.done} of {count} points.", "Arm again.")
            if now_s >= deadline_s:
                raise DeviceTimeout(self._device, f"{status.done} of {count} points complete after {timeout_s:g} s.")
            look_s = now_s + _EARLY_S if self._stops else due_s
            if now_s >= due_s:
                due_s, again_s = now_s + again_s, min(2 * again_s, _POLL_S)

    def _pause(self, until_s: float) -> None:
        """Sleeps at most until `until_s`; a service request or the next look at the status ends a long sleep early."""
        left_s = until_s - self.clock.now()
        if left_s <= _SHORT_WAIT_S:
            self.clock.sleep(left_s)
        else:
            self.link.wait_service_request(min(left_s - 0.5 * _SHORT_WAIT_S, _POLL_S, self._kick_period_s()))

    def _poll(self, wanted: int | None = None) -> Status:
        """The status, with the record of point `wanted` brought along if it is complete."""
        units = [b"ACQ:STAT?;:ACQ:MARK?" if self._settings.markers else b"ACQ:STAT?"]
        if wanted is None:
            return self._look(units, 0)[0]
        units.append(b"ACQ:DATA? %d,1" % wanted)
        status, block = self._look(units, 1)
        if block is not None:
            self._brought = (wanted, block)
        return status

    def _look(self, units: list[bytes], records: int) -> tuple[Status, memoryview | None]:
        """Status and, where it is there, a block of records. Whatever is asked, a trip is seen and answered."""
        assert self._axis is not None
        expected = 256 + records * record_bytes(self._axis.bins, self._wide)
        text, block, error = self.scpi.query_block(*self._kick_if_due(), *units, expected=expected)
        status = decode_status(self._device, text.decode("ascii", "replace"))
        if status.state in ("TRIP", "FAULT") and not self._trip_reported:
            self._tripped((error,) if error else ())
        if error is not None and error.code not in (_NOT_READY, _OVERRUN):
            self._refused(error)
        return status, block

    def read(self, first: int, count: int) -> list[Histogram]:
        """The histograms of points `first`.. since `arm`. A record that is damaged twice, or was overwritten before it
        was read, comes back empty and flagged `DATA_LOST`."""
        if self._axis is None or not 0 <= first <= first + count <= len(self._numbers):
            raise LimitError(self._device, f"points {first} to {first + count - 1} of {len(self._numbers)} armed.")
        if self._brought is not None and count == 1 and self._brought[0] == first:
            return [checked(self._fetch, self._brought[1], self._numbers, first, self._axis, self._wide)]
        return read_records(self._fetch, self._numbers, first, count, self._axis, self._wide)

    def _fetch(self, first: int, count: int) -> memoryview | None:
        """The records' block, or None where the instrument no longer has them."""
        status, block = self._look([b"ACQ:STAT?", b"ACQ:DATA? %d,%d" % (first, count)], count)
        if block is None and status.done < first + count:
            if status.state == "IDLE" and status.done == 0:
                raise DeviceReset(self._device, "it has forgotten the points it had taken.", "Arm again.")
            raise CommandRejected(self._device, f"point {first + count - 1} is not complete ({status.done} are).")
        return block

    def abort(self) -> None:
        self._call(b"ABOR")
        self._brought = None

    def rates(self) -> CountRates:
        with self._errors_named():
            try:
                answer = self.scpi.query(b"INP:RATE?")[0]
            except ErrorsReported as refusal:
                if refusal.errors[0].code != -221:
                    raise
                self.clock.sleep(0.1)  # the instrument counts for 100 ms after any change of its inputs
                answer = self.scpi.query(b"INP:RATE?")[0]
        sync, detector, _ = answer.split(",")
        return CountRates(float(sync), float(detector))

    # Protection

    def arm_watchdog(self, timeout_s: float) -> None:
        if timeout_s != 0 and not 0.1 <= timeout_s <= 60:
            raise LimitError(self._device, f"watchdog time {timeout_s:g} s is outside 0.1 to 60 s.", "0 turns it off.")
        self._call(f"SYST:WDOG {timeout_s:g}".encode())
        self._watchdog_s = timeout_s
        self._kicked_s = self.clock.now()

    def kick(self) -> None:
        self._call(b"SYST:WDOG:KICK")
        self._kicked_s = self.clock.now()

    def _kick_period_s(self) -> float:
        return self._watchdog_s / 4 if self._watchdog_s else float("inf")

    def _kick_if_due(self) -> list[bytes]:
        now_s = self.clock.now()
        if now_s - self._kicked_s < self._kick_period_s() * 0.9:
            return []
        self._kicked_s = now_s
        return [b"SYST:WDOG:KICK"]

    def clear_trip(self) -> None:
        """Clears a latched trip. For a person to call, after finding out why."""
        self._call(b"PROT:CLE")

    def close(self) -> None:
        """Stops, if the instrument still listens, and releases it."""
        try:
            self._call(b"ABOR")
        except DeviceError:
            pass  # closing must succeed whatever state the link is in
        finally:
            self.link.close()

    def _tripped(self, errors: Sequence[ScpiError]) -> NoReturn:
        """The instrument has shut the light off by itself; the command is sent all the same, and first."""
        self._trip_reported = True
        self.link.urgent(b"OUTP:SHUT CLOS\n", self.scpi.timeout_s)
        errors = (*errors, *self.scpi.drain_errors())
        cause = "" if is_trip(errors) else self.scpi.query(b"PROT:TRIP?")[0]
        raise safety_error(self._device, errors, cause)

    def _refused(self, error: ScpiError) -> NoReturn:
        with self._errors_named():
            raise ErrorsReported(self._device, "acquiring", (error, *self.scpi.drain_errors()))

    def _call(self, *units: bytes) -> None:
        with self._errors_named():
            self.scpi.command(*units)

    @contextmanager
    def _errors_named(self) -> Iterator[None]:
        """What the instrument reports, by its own name; a trip comes before everything else."""
        try:
            yield
        except ErrorsReported as report:
            if is_trip(report.errors):
                self._tripped(report.errors)
            raise
