"""A `tcspc488` as something to talk to: its status and its data asked for together, its trips seen, its watchdog kept.

Whatever is said to it, a trip that its answer shows is answered first, with the shutter command.
"""

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

from nlos.drivers.clock import Clock
from nlos.drivers.errors import DataCorrupt, DeviceError, DeviceReset, LimitError, ProtocolError
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.link.scpi import ErrorsReported, Scpi, ScpiError
from nlos.drivers.link.usb488 import Usb488
from nlos.drivers.link.usb_search import find_usb
from nlos.drivers.link.usbtmc import UsbtmcInterface, WireLog
from nlos.drivers.tcspc.counter import CountRates
from nlos.drivers.tcspc.tcspc488.messages import (
    Capacity,
    Status,
    decode_capacity,
    decode_identity,
    decode_rates,
    decode_status,
    is_trip,
    safety_error,
)
from nlos.drivers.tcspc.tcspc488.settings import Tcspc488Settings, input_commands
from nlos.drivers.tcspc.tcspc488.setup import Setup

_NOT_READY, _OVERRUN = -230, 104
_RATES_SETTLE_S = 0.1
_MEANWHILE_S = 0.01
"""A cable that is pulled, this one or the mirror's, is noticed within this time."""


class Instrument:
    """Opened, cleared, idle and with its inputs set up."""

    def __init__(
        self, settings: Tcspc488Settings, clock: Clock, backend: Any = None, wire_log: WireLog | None = None
    ) -> None:
        self.device = settings.model
        self.clock = clock
        self.warnings: list[str] = []
        self.shutter_opened = False
        self.trip_reported = False
        self._status_units = [b"ACQ:STAT?;:ACQ:MARK?" if settings.markers else b"ACQ:STAT?"]
        self._watchdog_s = 0.0
        self._kicked_s = 0.0
        self.meanwhile: Callable[[], None] = lambda: None
        serial = None if settings.usb in ("simulated", "auto") else settings.usb
        found = find_usb(self.device, settings.vendor_id, settings.product_id, serial, backend)
        self.link = Usb488(UsbtmcInterface(self.device, found, wire_log), clock)
        try:
            self.scpi = Scpi(self.device, self.link, settings.timeout_s)
            self.link.urgent(b"OUTP:SHUT CLOS\n", settings.timeout_s)  # before anything that it may refuse
            self.scpi.drain_errors()
            self.scpi.command(b"ABOR")  # whatever an earlier program left running
            self.identity: DeviceIdentity = decode_identity(self.device, self.scpi.query(b"*IDN?")[0])
            self.capacity: Capacity = decode_capacity(self.device, self.scpi.query(b"SYST:CAPS?")[0])
            self.setup = Setup(self.device, self.scpi, self.identity)
            self.setup.apply(input_commands(settings))
        except BaseException:
            self.link.close()
            raise

    def initiate(self, commands: dict[str, str], lists: dict[str, list[int]]) -> None:
        """Sets, reads back and starts. An instrument that restarted in between gets its settings again."""
        with self.errors_named():
            self.scpi.command(b"ABOR")
            self.setup.apply(commands, lists)
            self.restore(lists)
            self.scpi.command(b"INIT", retry=False)
        self.trip_reported = False

    def restore(self, lists: Mapping[str, Sequence[int]]) -> None:
        """Reads back all settings. Where the instrument lost them it gets them back; a shutter of its own has closed,
        though."""
        if not self.setup.restore(lists):
            return
        if self.shutter_opened:
            raise DeviceReset(self.device, "it restarted, which closed the shutter.", "Its settings are back: resume.")
        self.warnings.append("the counter restarted between two acquisitions; its settings were sent again")
        if self._watchdog_s:
            self.arm_watchdog(self._watchdog_s)

    def trigger(self) -> None:
        if self.link.capabilities.takes_trigger:
            self.link.trigger(self.scpi.timeout_s)
        else:
            self.link.write(b"*TRG\n", self.scpi.timeout_s)

    def look(self, data: bytes = b"", expected: int = 0) -> tuple[Status, memoryview | None]:
        """Status, and the block of about `expected` bytes that `data` asks for if it is there."""
        units = [*self._kick_if_due(), *self._status_units]
        if data:
            units.append(data)
        answer = self.scpi.query_block(*units, expected=256 + expected)
        if answer.after:
            raise DataCorrupt(self.device, f"{answer.after[:20]!r} came after its data.")
        return self._status(answer.before, answer.error), answer.block

    def take_records(self, most: int) -> tuple[Status, bytes]:
        """The T3 records that wait, and the status after them: what was lost before or among them shows in it. Raises
        `DataCorrupt` where they do not have their checksum.

        The instrument tells each record once: nothing is asked for again.
        """
        units = [*self._kick_if_due(), b"TTAG:DATA? %d" % most, b"TTAG:CRC?", *self._status_units]
        answer = self.scpi.query_block(*units, expected=256 + 4 * most, retry=False)
        data = bytes(answer.block or b"")
        checksum, _, text = (answer.before if answer.block is None else answer.after).partition(b";")
        status = self._status(text, answer.error)
        if checksum != b"%d" % zlib.crc32(data):
            raise DataCorrupt(self.device, f"{len(data)} bytes of records came without their checksum.")
        return status, data

    def _status(self, text: bytes, error: ScpiError | None) -> Status:
        """Whatever was asked, a trip is seen and answered before the data is looked at."""
        status = decode_status(self.device, text.decode("ascii", "replace"))
        if status.tripped and not self.trip_reported:
            self.tripped((error,) if error else ())
        if error is not None and error.code not in (_NOT_READY, _OVERRUN):
            with self.errors_named():
                raise ErrorsReported(self.device, "acquiring", (error, *self.scpi.drain_errors()))
        return status

    def pause(self, seconds: float) -> None:
        """Until a service request, the next kick, or for so long."""
        until_s = self.clock.now() + min(seconds, self._kick_period_s())
        while (left_s := until_s - self.clock.now()) > 0:
            self.meanwhile()
            if self.link.wait_service_request(min(left_s, _MEANWHILE_S)):
                return

    def rates(self) -> CountRates:
        with self.errors_named():
            try:
                answer = self.scpi.query(b"INP:RATE?")[0]
            except ErrorsReported as refusal:
                if -221 not in {each.code for each in refusal.errors}:  # an earlier exchange's mishap may stand before
                    raise
                until_s = self.clock.now() + _RATES_SETTLE_S  # it counts for 100 ms after any change of its inputs
                while (left_s := until_s - self.clock.now()) > 0:
                    self.pause(left_s)
                answer = self.scpi.query(b"INP:RATE?")[0]
        return decode_rates(self.device, answer)

    # Protection

    def arm_watchdog(self, timeout_s: float) -> None:
        if timeout_s != 0 and not 0.1 <= timeout_s <= 60:
            raise LimitError(self.device, f"watchdog time {timeout_s:g} s is outside 0.1 to 60 s.", "0 turns it off.")
        with self.errors_named():
            kept = self.scpi.query(f"SYST:WDOG {timeout_s:g}".encode(), b"SYST:WDOG?")[0]
        if kept != f"{timeout_s:g}":
            raise ProtocolError(self.device, f"its watchdog was set to {timeout_s:g} s and says {kept!r}.")
        self._watchdog_s = timeout_s
        self._kicked_s = self.clock.now()

    def kick(self) -> None:
        self.call(b"SYST:WDOG:KICK")
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
        self.call(b"PROT:CLE")

    def close(self) -> None:
        """Stops, if the instrument still listens, and releases it."""
        try:
            self.call(b"ABOR")
        except DeviceError:
            pass  # closing must succeed whatever state the link is in
        finally:
            self.link.close()

    def tripped(self, errors: Sequence[ScpiError]) -> NoReturn:
        """The instrument has shut the light off by itself; the command is sent all the same, and first."""
        self.trip_reported = True
        self.link.urgent(b"OUTP:SHUT CLOS\n", self.scpi.timeout_s)
        errors = (*errors, *self.scpi.drain_errors())
        cause = "" if is_trip(errors) else self.scpi.query(b"PROT:TRIP?")[0]
        raise safety_error(self.device, errors, cause)

    def call(self, *units: bytes) -> None:
        """Sends one command that answers nothing. Raises what the error queue says."""
        with self.errors_named():
            self.scpi.command(*units)

    @contextmanager
    def errors_named(self) -> Iterator[None]:
        """What the instrument reports, by its own name; a trip comes before everything else."""
        try:
            yield
        except ErrorsReported as report:
            if is_trip(report.errors):
                self.tripped(report.errors)
            raise
