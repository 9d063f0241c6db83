"""A serial port that frames, keeps its deadlines, and never takes a late reply for the answer to the next command."""

import contextlib
import threading
from collections.abc import Callable
from typing import Any

import serial
from serial.tools import list_ports

from nlos.drivers.clock import Clock
from nlos.drivers.errors import DeviceLost, DeviceTimeout, ProtocolError
from nlos.drivers.link.framing import Take, take_line
from nlos.drivers.link.open_errors import cannot_open
from nlos.drivers.link.port_lock import let_others_in, lock_out_others
from nlos.drivers.link.same_device import PortInfo, port_of

try:  # an unplugged port raises termios.error, which is not an OSError, from flush and from setting a timeout
    import termios

    _PORT_ERRORS: tuple[type[Exception], ...] = (OSError, termios.error)  # SerialException is an OSError
except ImportError:  # Windows
    _PORT_ERRORS = (OSError,)

if "nlos.drivers.simulated.serial" not in serial.protocol_handler_packages:  # where pyserial finds sim://
    serial.protocol_handler_packages.append("nlos.drivers.simulated.serial")

WireLog = Callable[[str, str, bytes], None]
"""(device, ">" sent or "<" received, bytes)"""

_MAX_MESSAGE = 256  # bytes; more without an end is no message
_OPEN_ERRORS: tuple[type[Exception], ...] = (ValueError, NotImplementedError, *_PORT_ERRORS)
_SLICE_S = 0.05  # a read is interrupted this often, so that a reply set aside by `interject` is found in time
_QUIET_S = 0.05  # silence after which nothing more of an old reply is expected


def available_ports() -> list[PortInfo]:
    """The serial ports of this computer."""
    found = sorted(list_ports.comports())
    return [PortInfo(p.device, p.description or "", p.serial_number or "", p.vid or 0, p.location or "") for p in found]


class SerialLine:
    """One command in flight, one reply, one deadline for the two together.

    After a timeout or garbage the line is out of step: the next `exchange` first throws away what still arrives and
    calls `resynchronise`, the device's own way of proving that the following reply can only be the next command's. So
    it does when bytes arrived that nobody asked for. It is given this line, with `in_step` as it was found, and the
    bytes thrown away. Errors: `DeviceTimeout`, `ProtocolError`, `DeviceLost`.
    """

    def __init__(
        self,
        device: str,
        port: Any,
        clock: Clock,
        *,
        timeout_s: float,
        resynchronise: Callable[["SerialLine", bytes], None],
        wire_log: WireLog | None = None,
    ) -> None:
        self.device = device
        self.timeout_s = timeout_s
        self.in_step = True
        self.half_sent = False  # whether a write was cut: the next bytes end half a command
        self._port = port
        self._clock = clock
        self._resynchronise = resynchronise
        self._wire_log = wire_log
        self._buffer = bytearray()
        self._lock = threading.RLock()
        self._in_flight, self._interjected = False, 0
        self._lost: DeviceLost | None = None
        self._said = b""
        self._unasked = bytearray()  # until `drain`: a device may have said that it restarted

    @classmethod
    def open(
        cls,
        device: str,
        url: str,
        clock: Clock,
        *,
        baud: int,
        timeout_s: float,
        resynchronise: Callable[["SerialLine", bytes], None],
        wire_log: WireLog | None = None,
    ) -> "SerialLine":
        """Opens a port, `/dev/ttyACM0`, `COM3` or any pyserial URL, for this program alone.

        Raises `DeviceNotFound`, `DeviceBusy` and `WrongDevice`, each saying what to do.
        """
        ports = available_ports()
        here = port_of(device, url, ports)
        try:
            port = serial.serial_for_url(here, baudrate=baud, timeout=0, write_timeout=timeout_s, exclusive=True)
        except _OPEN_ERRORS as error:
            raise cannot_open(device, here, error, [each.port for each in ports]) from error
        lock_out_others(port)
        return cls(device, port, clock, timeout_s=timeout_s, resynchronise=resynchronise, wire_log=wire_log)

    def exchange(self, command: bytes, timeout_s: float | None = None, take: Take = take_line) -> bytes:
        """Sends `command` and returns the message that answers it."""
        with self._lock:
            if not self.in_step or self._unasked or self._buffer or self._waiting():
                self.resynchronise()
            return self.transact(command, timeout_s, take)

    def transact(self, command: bytes, timeout_s: float | None = None, take: Take = take_line) -> bytes:
        """`exchange` without the look at what came before: for the `resynchronise` of a device."""
        with self._lock:
            deadline_s = self._deadline(timeout_s)
            in_step, self.in_step = self.in_step, False  # and so it stays if anything, a signal too, cuts this short
            self._in_flight = True
            try:
                self.write(command)
                message = self._message(deadline_s, take, f"{command[:40]!r} was not answered")
            finally:
                self._in_flight = False
            self.in_step = in_step
            return message

    def receive(
        self, wanted: Callable[[bytes], bool], timeout_s: float | None = None, what: str = "its name did not come"
    ) -> tuple[bytes, bytes]:
        """Lines until the wanted one: (that line, what came before it). `what`: for the error."""
        with self._lock:
            return self._line(wanted, self._deadline(timeout_s), what)

    def interject(self, command: bytes, answer: bytes, timeout_s: float = 0.1) -> None:
        """Sends a command that cannot wait and returns when `answer` confirms it.

        May be called from a signal handler while another command is in flight: that one's reply is let in first, for
        half of the time, and put back for whom it belongs to. A busy line is not waited for longer than `timeout_s`:
        then the command is sent all the same and `DeviceTimeout` says that nothing confirmed it.
        """
        if not self._lock.acquire(timeout=timeout_s):
            self.write(command)
            raise DeviceTimeout(self.device, f"{command!r} was sent over a busy line and not confirmed.")
        self._interjected += 1
        try:
            deadline_s = self._deadline(timeout_s)
            others = b""
            if self._in_flight:
                with contextlib.suppress(DeviceTimeout, ProtocolError):
                    others = self._message(self._deadline(timeout_s / 2), take_line, "") + b"\r\n"
            while (self._buffer or self._waiting()) and self._clock.now() < deadline_s:
                self.in_step = False  # an old reply must not confirm the new command
                self._keep_unasked()
                self._fill(0.0)
            self.write(command)
            _, before = self._line(lambda line: line == answer, deadline_s, f"{command!r} was not confirmed")
            self._buffer[:0] = others + before  # another command's answer, or what nobody asked for: a start-up text
        finally:
            self._lock.release()

    def resynchronise(self) -> None:
        """Back in step: what still arrives is thrown away, then the device proves that it listens."""
        with self._lock:
            try:
                self._resynchronise(self, self.drain())
            except BaseException:
                self.in_step = False
                raise
            self.in_step, self.half_sent = True, False

    def take_unasked(self) -> bytes:
        """What arrived since the last look at it that was no answer, and not understood."""
        taken, self._unasked = bytes(self._unasked), bytearray()
        return taken

    def drain(self) -> bytes:
        """Reads until the line has been quiet for 50 ms, for at most the timeout, and returns what came."""
        with self._lock:
            self._keep_unasked()
            drained, self._unasked = self._unasked, bytearray()
            deadline_s = self._deadline(None)
            while self._clock.now() < deadline_s and self._fill(_QUIET_S):
                drained += self._buffer[:_MAX_MESSAGE]
                self._buffer.clear()
            return bytes(drained)

    def look(self) -> bytes:
        """What has arrived that nobody asked for. Waits for nothing, and leaves it to the next `exchange`."""
        with self._lock:
            while len(self._buffer) <= _MAX_MESSAGE and self._waiting():
                self._fill(0.0)
            return bytes(self._unasked + self._buffer)

    def write(self, data: bytes) -> None:
        """Sends bytes and expects nothing."""
        self._check_usable()
        self._said = data.strip()
        if self._wire_log:
            self._wire_log(self.device, ">", data)
        try:
            written = self._port.write(data)
        except serial.SerialTimeoutException as error:
            self.in_step, self.half_sent = False, True
            raise DeviceTimeout(self.device, f"{data[:40]!r} could not be sent, the port does not take it.") from error
        except _PORT_ERRORS as error:
            raise self._gone(error) from error
        if written != len(data):
            self.in_step, self.half_sent = False, True
            raise DeviceTimeout(self.device, f"only {written} of {len(data)} bytes could be sent.")

    def close(self) -> None:
        """Releases the port; may be called twice, and after it was unplugged."""
        self._lost = self._lost or DeviceLost(self.device, "the port is closed.")
        let_others_in(self._port)
        with contextlib.suppress(*_PORT_ERRORS):  # it may be gone already
            self._port.close()

    def _keep_unasked(self) -> None:
        self._unasked += self._buffer[:_MAX_MESSAGE]
        del self._unasked[: -16 * _MAX_MESSAGE]
        self._buffer.clear()

    def _deadline(self, timeout_s: float | None) -> float:
        return self._clock.now() + (self.timeout_s if timeout_s is None else timeout_s)

    def _line(self, wanted: Callable[[bytes], bool], deadline_s: float, what: str) -> tuple[bytes, bytes]:
        before = b""
        try:
            while not wanted(line := self._message(deadline_s, take_line, what)):
                before += line + b"\r\n"
                if self._clock.now() >= deadline_s:
                    self.in_step = False
                    raise DeviceTimeout(self.device, f"{what} in time among {len(before)} bytes.")
        except BaseException:
            self._unasked[:0] = before
            raise
        return line, before

    def _message(self, deadline_s: float, take: Take, what: str) -> bytes:
        while True:
            echoed = self._said and self._buffer.startswith(self._said)
            try:
                message = take(self._buffer)
                if message is None and len(self._buffer) > _MAX_MESSAGE:
                    raise ValueError(f"more than {_MAX_MESSAGE} bytes without an end: {bytes(self._buffer[:40])!r}...")
            except ValueError as error:
                self._keep_unasked()
                self.in_step = False
                raise self._echoes() if echoed else ProtocolError(self.device, f"{error}.") from error
            if message is not None and not echoed:
                return message
            if message is not None:
                self.in_step = False
                raise self._echoes()
            remaining_s = deadline_s - self._clock.now()
            if remaining_s <= 0:
                self.in_step = False
                got = f", only {bytes(self._buffer[:40])!r} came" if self._buffer else ""
                bare = b"\n" in self._buffer and b"\r" not in self._buffer
                ends = ", and what translates line ends on the way: its lines end without CR" if bare else ""
                raise DeviceTimeout(self.device, f"{what} in time{got}.", f"Check its cable and power{ends}.")
            self._fill(min(remaining_s, _SLICE_S))

    def _echoes(self) -> ProtocolError:
        return ProtocolError(
            self.device,
            f"the port sends {self._said[:40]!r} back as it was sent.",
            "Turn off the local echo of the adapter, or that of the program that shares the port.",
        )

    def _fill(self, timeout_s: float) -> int:
        """Waits for bytes, appends what is there to the buffer; returns how many."""
        self._check_usable()
        data, interjected = b"", self._interjected
        try:
            waiting = self._port.in_waiting
            if not waiting and self._port.timeout != timeout_s:
                self._port.timeout = timeout_s
            data = self._port.read(min(waiting, 4096) or 1)
            if data and not waiting:
                data += self._port.read(min(self._port.in_waiting, 4096))
        except _PORT_ERRORS as error:
            if self._interjected == interjected or self._lost is not None:
                raise self._gone(error) from error
            # else a signal handler took the bytes that this read was told of, and put back what was not its own
        if data and self._wire_log:
            self._wire_log(self.device, "<", data)
        self._buffer += data
        return len(data)

    def _waiting(self) -> int:
        self._check_usable()
        try:
            return int(self._port.in_waiting)
        except _PORT_ERRORS as error:
            raise self._gone(error) from error

    def _check_usable(self) -> None:
        if self._lost is not None:
            raise DeviceLost(self.device, self._lost.what, self._lost.remedy)

    def _gone(self, error: Exception) -> DeviceLost:
        self.in_step, self._lost = False, DeviceLost(self.device, f"the serial port went away ({error}).")
        return self._lost
