"""Talking to a TriggerScope-MM: who answers, does each reply confirm its command, did it restart."""

import contextlib
from collections.abc import Iterable, Sequence
from functools import partial
from itertools import cycle
from typing import Self

from nlos.drivers.clock import Clock
from nlos.drivers.errors import (
    CommandRejected,
    DeviceError,
    DeviceReset,
    DeviceTimeout,
    MirrorDisturbed,
    ProtocolError,
    WrongDevice,
)
from nlos.drivers.galvo.triggerscope import wire
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.link.same_device import remember
from nlos.drivers.link.serial_line import SerialLine, WireLog, available_ports

DEVICE = "triggerscope"
REOPEN = "Close the shutter, check the controller, then open the bench again."


class RangeChanged(MirrorDisturbed):
    """Somebody changed a DAC's range, which moved the mirror and gave every code another meaning."""


class Controller:
    """Strictly one command in flight: of two that arrive together the controller loses the second."""

    def __init__(self, line: SerialLine, identity: DeviceIdentity, gave_banner: bool) -> None:
        self.identity = identity
        self.gave_banner = gave_banner
        self._line = line

    @classmethod
    def open(
        cls,
        port: str,
        clock: Clock,
        *,
        timeout_s: float,
        banner_timeout_s: float,
        wire_log: WireLog | None = None,
        last_words: Sequence[bytes] = (),
    ) -> Self:
        """Opens the port, takes the start-up banner where one comes, and asks who answers. Where no answer can be
        understood `last_words` are sent all the same: it may hear.

        Raises `DeviceNotFound`, `DeviceBusy`, `WrongDevice`, `DeviceTimeout`, `ProtocolError`.
        """
        line = SerialLine.open(
            DEVICE, port, clock, baud=115_200, timeout_s=timeout_s, resynchronise=_Proof(), wire_log=wire_log
        )
        try:
            gave_banner = _wait_for_banner(line, banner_timeout_s)
            line.in_step = True
            _spoil(line)
            replies = [_says(line) for _ in range(2)]
            identity = wire.decode_identity(replies[0])
            if replies[0] == replies[1] and identity is None and replies[0].startswith(b"ARC TRIGGERSCOPE"):
                raise WrongDevice(
                    DEVICE,
                    f"{port} says {replies[0][:60]!r}, firmware that this driver does not drive.",
                    "Load TriggerScope-MM firmware, v.612 or newer, onto a board V4 or V4B; no other board is driven.",
                )
            if identity is None or replies[0] != replies[1]:
                raise WrongDevice(
                    DEVICE,
                    f"{port} says {replies[0][:60]!r}, then {replies[1][:60]!r}, and is not a TriggerScope-MM.",
                    "Correct `port` in the bench file; `nlos devices` lists what is plugged in.",
                )
        except BaseException as error:
            if isinstance(error, DeviceTimeout | ProtocolError):
                with contextlib.suppress(DeviceError):
                    _say_unheard(line, last_words)
            line.close()
            raise
        remember(port, available_ports())
        return cls(line, identity, gave_banner)

    def command(self, command: bytes) -> None:
        """Sends a command and returns when its echo confirms it. Raises `CommandRejected`, `DeviceReset`,
        `RangeChanged`, `ProtocolError`, `DeviceTimeout`, `DeviceLost`."""
        reply = self._ask(command)
        if reply != wire.echo(command) and not _need_not_be_known(command, reply):
            raise self._wrong(command, reply)

    def upload(self, lines: Iterable[tuple[bytes, bytes]]) -> bool:
        """Sends table lines; False as soon as the controller kept other counts than were sent."""
        for command, expected in lines:
            reply = self._ask(command)
            if reply == expected:
                continue
            if reply.startswith(b"!" + command[:5]):
                return False
            raise self._wrong(command, reply)
        return True

    def interject(self, command: bytes) -> None:
        """Sends a command that cannot wait, also from a signal handler, and returns when its echo confirms it. Half a
        command is spoiled first: completed, it might be the one that opens the shutter."""
        if self._line.half_sent:
            self.command(command)
            return
        try:
            self._line.interject(command, wire.echo(command))
        except (DeviceTimeout, ProtocolError):
            self.command(command)

    def look(self) -> None:
        """Raises `DeviceLost` where the cable is gone, `DeviceReset` after a banner. Sends nothing."""
        if _names_itself(self._line.look()):
            self._line.in_step = False
            raise _restarted()

    def recover(self) -> bool:
        """In step again after whatever happened; whether the ranges are as they were set."""
        try:
            self._line.resynchronise()
        except (DeviceReset, RangeChanged):
            return False
        return True

    def command_unheard(self, commands: Iterable[bytes]) -> None:
        """Sends commands, one after the other, to a controller whose replies do not come. Raises `DeviceLost`."""
        _say_unheard(self._line, commands)

    def close(self) -> None:
        self._line.close()

    def _ask(self, command: bytes) -> bytes:
        reply = self._line.exchange(command)
        if reply.startswith((b"!ERROR_", wire.UNKNOWN)) and not _need_not_be_known(command, reply):
            raise CommandRejected(DEVICE, f"{command[:40]!r} was refused: {reply.decode('ascii')}.", REOPEN)
        if reply == b"done." or wire.decode_identity(reply):
            self._line.in_step = False
            raise _restarted()
        return reply

    def _wrong(self, command: bytes, reply: bytes) -> DeviceError:
        self._line.in_step = False
        if wire.range_changed(reply):
            return _range_changed()
        return ProtocolError(DEVICE, f"{command[:40]!r} was answered by {reply[:60]!r}.", REOPEN)


def _says(line: SerialLine) -> bytes:
    """Who answers. Another program's command may be answered in between; the ranges are set later anyway."""
    reply = line.exchange(wire.IDENTIFY)
    return line.receive(_names_itself, line.timeout_s)[0] if wire.range_changed(reply) else reply


def _say_unheard(line: SerialLine, commands: Iterable[bytes]) -> None:
    for command in commands:
        with contextlib.suppress(DeviceTimeout):
            line.write(command)
            line.drain()


def _need_not_be_known(command: bytes, reply: bytes) -> bool:
    """Whether this refusal says that the firmware has nothing of what the command switches off."""
    return reply == wire.UNKNOWN and command.startswith((wire.LEDS_OFF, b"WAV"))


def _names_itself(line: bytes) -> bool:
    return wire.decode_identity(line) is not None


def _wait_for_banner(line: SerialLine, timeout_s: float) -> bool:
    """Whether the identity line comes unasked, after whatever else (`done.`)."""
    try:
        line.receive(_names_itself, timeout_s)
    except (DeviceTimeout, ProtocolError):
        return False
    return True


def _spoil(line: SerialLine) -> bytes:
    """Half a line, left by a killed program or by a write that was cut, is thrown away before anything can complete
    it. Returns the lines that came before the error that answers."""
    line.write(wire.SPOIL)
    try:
        return line.receive(lambda reply: b"ERROR_" in reply, line.timeout_s / 2)[1]
    except (DeviceTimeout, ProtocolError):
        return b""


class _Proof:
    """In step: commands are answered in order, so after the answer to a question that no earlier one was like, none to
    an earlier command is outstanding.

    The question is for the length of a table, each time the next one's, and never who it is: what names itself unasked
    has restarted, and a late answer is not taken for that. An answer that nobody waited for is no noise: a command was
    carried out a second time, or another program's was, and the mirror may have moved.
    """

    def __init__(self) -> None:
        self._dacs = cycle(wire.DACS)

    def __call__(self, line: SerialLine, stale: bytes) -> None:
        in_step = line.in_step
        stale += _spoil(line)
        for attempt in range(2):
            question = wire.ask_states(next(self._dacs))
            line.write(question)
            try:
                _, before = line.receive(
                    partial(_answers, question), line.timeout_s / 2, f"{question!r} was not answered"
                )
            except (DeviceTimeout, ProtocolError):
                if attempt == 1:
                    raise
            else:
                stale += before
                break
        stale += line.take_unasked()
        if _names_itself(stale):
            raise _restarted()
        if wire.range_changed(stale):
            raise _range_changed()
        if in_step and b"!" in stale:
            raise ProtocolError(DEVICE, f"it answered a command that nobody sent: {stale[:60]!r}.", REOPEN)


def _answers(question: bytes, line: bytes) -> bool:
    return line.startswith(wire.echo(question) + b"-")


def _restarted() -> DeviceReset:
    return DeviceReset(DEVICE, "the controller restarted: its ranges and sequences are gone.", REOPEN)


def _range_changed() -> RangeChanged:
    return RangeChanged(DEVICE, "another program changed the range of a DAC, which moved the mirror.", REOPEN)
