"""Talking to an Optotune MR-E-2 or MR-E-3: text in Simple mode, binary read-back in Pro mode, and back."""

import contextlib
import re
from collections.abc import Iterator
from typing import Self

from nlos.drivers.clock import Clock
from nlos.drivers.errors import CommandRejected, DeviceReset, DeviceTimeout, ProtocolError, WrongDevice
from nlos.drivers.galvo.optotune import wire
from nlos.drivers.galvo.optotune.wire import Status
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.link.repeats import repeated
from nlos.drivers.link.same_device import remember
from nlos.drivers.link.serial_line import SerialLine, WireLog, available_ports

DEVICE = "optotune"
REOPEN = "Close the shutter, check the controller, then open the bench again."


_NO_FRAME = (
    "Check its cable and power; a port or adapter with flow control by XON and XOFF swallows bytes of such frames."
)


class Controller:
    """Every command is answered, so that replies are counted against commands; which command a reply answers it does
    not say. Raises `DeviceTimeout`, `ProtocolError`, `DeviceReset`, `DeviceLost`, `CommandRejected`."""

    def __init__(self, line: SerialLine, model: str) -> None:
        self._line = line
        self.model = model
        """"MR-E-2" or "MR-E-3"."""

    @classmethod
    def open(cls, port: str, clock: Clock, *, timeout_s: float, wire_log: WireLog | None = None) -> Self:
        """Opens the port and makes sure of Simple mode, also where somebody left Pro mode on.

        Raises `DeviceNotFound`, `DeviceBusy`, `WrongDevice`.
        """
        proof = _Proof()
        line = SerialLine.open(
            DEVICE, port, clock, baud=256_000, timeout_s=timeout_s, resynchronise=proof, wire_log=wire_log
        )
        try:
            line.drain()
            proof.name, _, _ = _to_simple_mode(line)
            line.in_step = True
        except BaseException:
            line.close()
            raise
        remember(port, available_ports())
        return cls(line, wire.names_model(proof.name))

    def identity(self) -> DeviceIdentity:
        """Who answers. Asked twice: nothing in a reply says which command it answers, or that it is undamaged."""
        asks = (b"GETID\r\n", b"GETVERSION\r\n", b"GETSN\r\n")
        first, (model, version, serial) = ([self._line.exchange(ask) for ask in asks] for _ in range(2))
        if first != [model, version, serial] or {b"OK", b"NO", b"ERROR"} & set(first):
            raise ProtocolError(
                DEVICE, f"it identified itself as {first!r}, then as {[model, version, serial]!r}.", REOPEN
            )
        if wire.names_model(model) != self.model:  # one bit tells the two apart, and they have other registers
            raise ProtocolError(DEVICE, f"it identified itself as {self.model}, then as {model!r}.", REOPEN)
        return DeviceIdentity("optotune", "Optotune", model.decode(), serial.decode(), version.decode())

    def set_position(self, x: float, y: float) -> bool:
        """Sends coordinates on the unit disc. False where the controller trimmed them: the mirror then went somewhere
        else."""
        command = wire.set_position(x, y)
        match self._line.exchange(command):
            case b"OK":
                return True
            case b"OL" | b"OU":
                return False
            case b"NO" | b"ERROR" as reply:
                raise CommandRejected(DEVICE, f"{command!r} was refused: {reply.decode()}.", REOPEN)
            case reply:
                self._line.in_step = False
                raise _restarted() if wire.names_model(reply) else _wrong(command, reply)

    def status(self) -> Status:
        """The status register."""
        reply = self._line.exchange(b"STATUS\r\n")
        status = wire.decode_status(reply)
        if status is None:
            self._line.in_step = False
            raise _restarted() if wire.names_model(reply) else _wrong(b"STATUS", reply)
        return status

    def acknowledge(self) -> None:
        """Clears the latched half of the status register."""
        reply = self._line.exchange(b"ACKNOWLEDGE\r\n")
        if reply != b"OK":
            self._line.in_step = False
            raise _wrong(b"ACKNOWLEDGE", reply)

    def measured_position(self) -> tuple[float, float]:
        """Where the controller's own sensor sees the mirror, on the unit disc."""
        payload = self._read(*wire.MEASURED_XY[self.model])
        try:
            return wire.decode_position(payload)
        except ValueError as error:
            raise ProtocolError(DEVICE, f"{error}.", REOPEN) from error

    def board_faults(self) -> int:
        """The board's fault register."""
        payload = self._read(wire.BOARD_FAULTS)
        if len(payload) != 4:
            raise ProtocolError(DEVICE, f"{payload!r} is not a 32-bit register.", REOPEN)
        return int.from_bytes(payload, "big")

    def look(self) -> None:
        """Raises `DeviceLost` where the cable is gone, `DeviceReset` where it says its name unasked. Sends nothing."""
        if wire.names_model(self._line.look()):
            self._line.in_step = False
            raise _restarted()

    def recover(self) -> None:
        """In step again after whatever happened, a restart included; for commands that are right from any state."""
        with contextlib.suppress(DeviceReset):
            self._line.resynchronise()

    def centre_unheard(self) -> None:
        """Sends the mirror to its centre although its replies do not come. Raises `DeviceLost`."""
        with contextlib.suppress(DeviceTimeout):
            self._line.write(wire.set_position(0.0, 0.0))

    def close(self) -> None:
        self._line.close()

    def _read(self, *registers: int) -> bytes:
        """The registers' bytes. After a damaged frame they are asked for once more: reading changes nothing."""
        try:
            return self._read_once(*registers)
        except _FrameDamaged as damaged:
            repeated(DEVICE, damaged.what)
            return self._read_once(*registers)

    def _read_once(self, *registers: int) -> bytes:
        with self._pro_mode():
            return self._ask(wire.get_registers(*registers))

    @contextlib.contextmanager
    def _pro_mode(self) -> Iterator[None]:
        reply = self._line.exchange(b"GOPRO\r\n")
        if reply != b"OK":
            self._line.in_step = False
            raise _wrong(b"GOPRO", reply)
        try:
            yield
            self._ask(wire.to_simple())
        finally:
            self._line.in_step = False  # the next text command first proves that Simple mode is back
        self._line.resynchronise()

    def _ask(self, request: bytes) -> bytes:
        """The payload of the reply to a request, whose command is its third byte."""
        command, came = request[2], False

        def take(buffer: bytearray) -> bytes | None:
            nonlocal came
            came = came or len(buffer) > 0
            return wire.take_frame(buffer)

        try:
            frame = self._line.exchange(request, take=take)
            answered, answer = wire.decode_frame(frame)
        except ValueError as error:
            raise _FrameDamaged(DEVICE, f"{error}.", REOPEN) from error
        except DeviceTimeout as error:
            if came:
                raise _FrameDamaged(DEVICE, f"a frame has no end: {error.what}", REOPEN) from error
            raise DeviceTimeout(DEVICE, error.what, _NO_FRAME) from error
        if answered == command | wire.REFUSED:
            why = wire.reason(answer)
            raise CommandRejected(DEVICE, f"Pro-mode command 0x{command:02x} was refused: {why}.", REOPEN)
        if answered != command:
            raise ProtocolError(DEVICE, f"command 0x{command:02x} was answered by 0x{answered:02x}.", REOPEN)
        return answer


class _FrameDamaged(ProtocolError):
    """A Pro-mode frame that did not come whole."""


class _Proof:
    """In step, and in Simple mode. An answer that nobody waited for is no noise: a command was carried out twice, and
    the mirror may have moved. Whatever names the controller otherwise than its answer to GETID did is its start-up."""

    def __init__(self) -> None:
        self.name = b""
        """What it answers to GETID; empty until it was asked."""

    def __call__(self, line: SerialLine, stale: bytes) -> None:
        in_step = line.in_step
        _, beyond, missed = _to_simple_mode(line, self.name)
        stale += beyond
        unasked = in_step and re.search(rb"OK|NO|OL|OU|ERROR|0x|[0-9A-Fa-f]{8}|~", stale)
        others = [each for each in (stale + b"\r\n" + missed).split(b"\r\n") if each != self.name]
        if wire.names_model(stale) or any(map(wire.names_model, others)):
            raise _restarted()
        if unasked:
            raise ProtocolError(DEVICE, f"it answered a command that nobody sent: {stale[:60]!r}.", REOPEN)


def _to_simple_mode(line: SerialLine, name: bytes = b"") -> tuple[bytes, bytes, bytes]:
    """Simple mode, and no reply outstanding: only GETID is answered by the model, and replies keep their order. Returns
    that answer, what else came where each question had its reply, and where not.

    The first START after Pro mode or after garbage may be refused; one that nothing answers went to Pro mode.
    """

    def is_name(reply: bytes) -> bool:
        return reply == name if name else bool(wire.names_model(reply))

    said, missed = b"", b""
    for attempt in range(3):
        try:
            for _ in range(2):
                if (began := line.transact(b"START\r\n", line.timeout_s / 4)) == b"OK":
                    break
                missed += began + b"\r\n"
            said, beyond = line.transact(b"GETID\r\n", line.timeout_s / 4), b""
            if not is_name(said):
                before = said
                said, more = line.receive(is_name, line.timeout_s / 4)
                beyond = before + b"\r\n" + more
            # What was not answered in time may be so now: that is nobody else's.
            missed += line.take_unasked()
            return (said, beyond, missed) if attempt == 0 else (said, b"", missed + beyond)
        except (DeviceTimeout, ProtocolError):
            if attempt == 2 and said not in (b"", b"OK", b"NO"):
                raise WrongDevice(
                    DEVICE, f"{said[:60]!r} is not what an MR-E-2 or MR-E-3 says.", "Correct `port` in the bench file."
                ) from None
            if attempt == 2:
                raise
        line.write(wire.to_simple())
        missed += said + b"\r\n" + line.drain() + b"\r\n"
    raise AssertionError("the third attempt returns or raises")


def _wrong(command: bytes, reply: bytes) -> ProtocolError:
    return ProtocolError(DEVICE, f"{command!r} was answered by {reply[:60]!r}.", REOPEN)


def _restarted() -> DeviceReset:
    return DeviceReset(DEVICE, "the controller restarted: where the mirror points is not known.", REOPEN)
