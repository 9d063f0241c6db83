"""A pyserial port at `sim://NAME`, on any operating system: what is plugged in there answers in the bench's time."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from serial import PortNotOpenError, SerialBase, SerialException, SerialTimeoutException

from nlos.drivers.errors import DeviceBusy
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.serial.cable import SerialCable, SerialFirmware

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_FLUSH_ERROR: type[Exception]
try:  # what a real port raises from flush when it is gone
    import termios

    _FLUSH_ERROR = termios.error
except ImportError:  # Windows
    _FLUSH_ERROR = SerialException

_cables: dict[str, SerialCable] = {}
_coming_back: dict[str, tuple[float, SerialCable]] = {}
"""Pulled, and plugged in again at a time of the bench's clock."""
_taken: dict[str, object] = {}


def plug(name: str, firmware: SerialFirmware, bench: SimulatedBench, latency_s: float = 0.0) -> str:
    """Plugs a firmware in as `sim://NAME` and returns that URL. Raises `DeviceBusy` where a host uses the name."""
    old = _cables.get(name)
    if old is not None and old.held:
        raise _in_use(name)
    _coming_back.pop(name, None)
    _cables[name] = SerialCable(name, firmware, bench, latency_s)
    return f"sim://{name}"


def unplug(name: str) -> None:
    """Pulls the cable: whoever has the port open sees it vanish. Does nothing where none is plugged in."""
    _coming_back.pop(name, None)
    cable = _cables.pop(name, None)
    if cable is not None:
        cable.plugged = False


@contextmanager
def plugged_in(name: str, firmware: SerialFirmware, bench: SimulatedBench, latency_s: float) -> Iterator[None]:
    """As `plug`, until the block is left. No second one gets the name meanwhile, nor pulls the cable of the first: two
    threads may open the same bench at once. Raises `DeviceBusy`."""
    claim = object()
    if _taken.setdefault(name, claim) is not claim:
        raise _in_use(name)
    try:
        plug(name, firmware, bench, latency_s)
        try:
            yield
        finally:
            unplug(name)
    finally:
        del _taken[name]


def _in_use(name: str) -> DeviceBusy:
    return DeviceBusy(name, f"sim://{name} is in use.", "Close the bench that uses it or give this one another port.")


def plugged(name: str) -> SerialCable:
    """The cable of that name. Raises `KeyError`."""
    return _cables[name]


class SimulatedSerial(SerialBase):
    """Reads and writes as pyserial's own ports do, errors included; a read that waits moves the bench's clock."""

    _cable: SerialCable | None = None

    def open(self) -> None:
        if self.port is None:
            raise SerialException("Port must be configured before it can be used.")
        if self.is_open:
            raise SerialException("Port is already open.")
        name = self.port.split("://", 1)[1]
        when_s, again = _coming_back.get(name, (0.0, None))
        if again is not None and again.clock.now() >= when_s:
            _cables[name] = _coming_back.pop(name)[1]
        cable = _cables.get(name)
        fault = cable.strikes("G10") if cable else None
        kind = str(fault.parameters.get("kind", "busy")) if fault else ""
        if cable is None or kind == "missing":
            raise SerialException(errno.ENOENT, f"could not open port {self.port}: nothing is plugged in there")
        if kind == "permission":
            raise SerialException(errno.EACCES, f"could not open port {self.port}: permission denied")
        if cable.held or kind == "busy":  # one host only, whether it asks for `exclusive` or not
            raise SerialException(errno.EAGAIN, f"Could not exclusively lock port {self.port}")
        self._cable = cable
        cable.open()
        self.is_open = True

    def close(self) -> None:
        if self.is_open and self._cable is not None:
            self._cable.close()
        self.is_open = False

    @property
    def in_waiting(self) -> int:
        return self._open_cable("in_waiting").arrived()

    def read(self, size: int = 1) -> bytes:
        """At most `size` bytes; fewer when the timeout passes first."""
        cable = self._open_cable("read")
        deadline_s = None if self.timeout is None else cable.clock.now() + self.timeout
        data = bytearray()
        while len(data) < size:
            when_s = cable.next_event_s()
            if when_s is None and deadline_s is None:
                raise SerialException("a read without a timeout would never return: nothing is on its way")
            if when_s is None or (deadline_s is not None and when_s > deadline_s):
                cable.clock.advance_to(deadline_s or 0.0)
                break
            cable.clock.advance_to(when_s)
            data += cable.take(size - len(data))
            if self.inter_byte_timeout is not None:
                pause_ends_s = cable.clock.now() + self.inter_byte_timeout
                deadline_s = pause_ends_s if deadline_s is None else min(deadline_s, pause_ends_s)
        return bytes(data)

    def write(self, data: "ReadableBuffer", /) -> int:
        """Sends bytes, or raises `SerialTimeoutException` where the port does not take them in time."""
        cable = self._open_cable("write")
        data = bytes(data)
        if fault := cable.strikes("G9"):
            cable.send(data[: int(fault.parameters.get("sent", 0))])
            cable.clock.sleep(self.write_timeout or 0.0)
            raise SerialTimeoutException("Write timeout")
        cable.send(data)
        return len(data)

    def flush(self) -> None:
        self._open_cable("flush").deliver()

    @property
    def out_waiting(self) -> int:
        self._open_cable("out_waiting")
        return 0

    def reset_input_buffer(self) -> None:
        self._open_cable("flush").forget_arrived()

    def reset_output_buffer(self) -> None:
        self._open_cable("flush")

    def cancel_read(self) -> None:
        """Nothing to do: no read blocks."""

    def cancel_write(self) -> None:
        """Nothing to do: no write blocks."""

    @property
    def cts(self) -> bool:
        self._open_cable("cts")
        return True

    dsr = cd = cts

    @property
    def ri(self) -> bool:
        self._open_cable("ri")
        return False

    def _reconfigure_port(self) -> None:
        self._open_cable("configure")

    def _update_rts_state(self) -> None:
        self._open_cable("rts")

    _update_dtr_state = _update_break_state = _update_rts_state

    def _open_cable(self, operation: str) -> SerialCable:
        """The cable, or the error that a real port raises from this operation when it is closed or gone."""
        if not self.is_open or self._cable is None:
            raise PortNotOpenError
        cable = self._cable
        fault = cable.strikes("G8", operation)
        if fault and cable.plugged:
            cable.plugged = False
            _cables.pop(cable.name, None)
            if after_s := fault.parameters.get("replug_after_s"):
                _coming_back[cable.name] = (cable.clock.now() + float(after_s), cable.plugged_anew())
        if cable.plugged:
            return cable
        if operation == "flush":
            raise _FLUSH_ERROR(errno.EIO, "Input/output error")
        if operation in ("in_waiting", "out_waiting", "cts", "ri", "rts"):
            raise OSError(errno.EIO, "Input/output error")
        raise SerialException(f"{operation} failed: [Errno {errno.EIO}] Input/output error")
