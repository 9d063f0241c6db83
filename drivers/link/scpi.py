"""SCPI over a message link: commands that are always checked, queries, definite blocks and the error queue.

Every message ends with `SYST:ERR?`, so that one round trip both does the work and proves that it was done.
"""

import re
from dataclasses import dataclass
from typing import Protocol

from nlos.drivers.errors import CommandRejected, DataCorrupt, DeviceTimeout, ProtocolError
from nlos.drivers.link.repeats import repeated

_ERROR = re.compile(rb'([+-]?\d{1,6}),"((?:[^"]|"")*)"\n?\Z')
_NO_ERROR = b'0,"No error"\n'
_QUEUE_LENGTH = 16
_EXCHANGE = {-410, -420, -430}
"""Interrupted, unterminated, deadlocked: the link's mishaps, not the command's."""


class MessageLink(Protocol):
    """What carries the messages: USBTMC here; anything else that has whole messages would do."""

    def ask(self, message: bytes, timeout_s: float, expected: int = 4096) -> bytes:
        """Sends a message and returns its whole answer, of `expected` bytes or so. Raises `DeviceError`."""
        ...

    def clear(self) -> None:
        """Brings both ends back to where a new message can begin."""
        ...


@dataclass(frozen=True)
class ScpiError:
    """One entry of the instrument's error queue."""

    code: int
    text: str

    def __str__(self) -> str:
        return f"{self.code} {self.text}"


class ErrorsReported(CommandRejected):
    """The instrument reported errors; `errors` has them, oldest first."""

    def __init__(self, device: str, message: str, errors: tuple[ScpiError, ...]) -> None:
        self.errors = errors
        super().__init__(device, f"{message!r} was answered with {', '.join(map(str, errors))}.")


def encode_block(payload: bytes) -> bytes:
    """An IEEE 488.2 definite block: `#`, how many digits, how many bytes, the bytes."""
    digits = str(len(payload)).encode()
    if len(digits) > 9:
        raise ValueError(f"a definite block holds at most 999999999 bytes, not {len(payload)}")
    return b"#%d%s%s" % (len(digits), digits, payload)


def decode_block(answer: bytes, start: int = 0) -> tuple[memoryview, int]:
    """The payload of the definite block at `start`, and where the answer continues after it.

    Raises ValueError for anything else, the indefinite `#0` included.
    """
    count = answer[start + 1 : start + 2]
    if answer[start : start + 1] != b"#" or not count.isdigit() or count == b"0":
        raise ValueError(f"not a definite block: {answer[start : start + 12]!r}")
    first = start + 2 + int(count)
    digits = answer[start + 2 : first]
    if len(digits) != int(count) or not digits.isdigit():
        raise ValueError(f"block length is {digits!r}")
    end = first + int(digits)
    if end > len(answer):
        raise ValueError(f"the block has {len(answer) - first} of {int(digits)} bytes")
    return memoryview(answer)[first:end], end


def decode_error(answer: bytes) -> ScpiError:
    """One answer to `SYST:ERR?`. Raises ValueError for anything else."""
    match = _ERROR.match(answer)
    if match is None:
        raise ValueError(f"not an error report: {answer[:40]!r}")
    return ScpiError(int(match[1]), match[2].decode("ascii", "replace").replace('""', '"'))


def split_error(answer: bytes) -> tuple[bytes, ScpiError | None]:
    """What stands before the error report that ends every answer, and the error if there is one."""
    if answer.endswith(_NO_ERROR):
        body, error = answer[: -len(_NO_ERROR)], None
    else:
        start = answer.rfind(b";") + 1
        try:
            error = decode_error(answer[start:])
        except ValueError:  # a semicolon inside the error's own text
            start = answer[: answer.rfind(b',"')].rfind(b";") + 1
            error = decode_error(answer[start:])
        body, error = answer[:start], error if error.code else None
    if body and not body.endswith(b";"):
        raise ValueError(f"the answer runs into its error report: {body[-20:]!r}")
    return body[:-1], error


@dataclass(frozen=True)
class BlockAnswer:
    """What a message with one block query brought: text before the block, the block if one came, text after it."""

    before: bytes
    block: memoryview | None
    after: bytes
    error: ScpiError | None


def split_block(answer: bytes) -> BlockAnswer:
    """Reads an answer that ends in an error report. Raises ValueError where its parts do not fit together."""
    mark = answer.find(b"#")
    if mark < 0:
        body, error = split_error(answer)
        return BlockAnswer(body, None, b"", error)
    block, end = decode_block(answer, mark)
    if answer[end : end + 1] != b";" or answer[max(0, mark - 1) : mark] not in (b";", b""):
        raise ValueError(f"the block ends in {answer[end : end + 20]!r}")
    after, error = split_error(answer[end + 1 :])
    return BlockAnswer(answer[: max(0, mark - 1)], block, after, error)


class Scpi:
    """Commands and queries to one instrument."""

    def __init__(self, device: str, link: MessageLink, timeout_s: float) -> None:
        self._device = device
        self._link = link
        self.timeout_s = timeout_s

    def command(self, *units: bytes, retry: bool = True) -> None:
        """Sends the units as one message. Raises `ErrorsReported`.

        `retry` says that doing them twice is harmless: after a timeout they are sent once more.
        """
        body = self._ask(b";:".join(units), 256, retry)
        if body:
            raise ProtocolError(self._device, f"{body[:40]!r} came in answer to a command without one.")

    def query(self, *units: bytes, retry: bool = True) -> list[str]:
        """The answers to the units, one each. Raises `ErrorsReported`."""
        body = self._ask(b";:".join(units), 1024, retry)
        answers = [each.decode("ascii", "replace") for each in body.split(b";")]
        if not all(answers) or len(answers) != sum(unit.partition(b" ")[0].endswith(b"?") for unit in units):
            raise ProtocolError(self._device, f"{body[:60]!r} does not answer {b';:'.join(units)!r}.")
        return answers

    def query_block(self, *units: bytes, expected: int, retry: bool = True) -> BlockAnswer:
        """The answer to queries one of which gives a definite block.

        The block is None where the instrument gave none. Nothing is raised for a reported error: data and error are
        for the caller to weigh. A damaged or lost answer is asked for once more, unless `retry` is False because the
        instrument tells everything once; then `DataCorrupt` is raised.
        """
        message = b";:".join(units) + b";:SYST:ERR?\n"
        while True:
            try:
                answer = split_block(self._retried(message, expected + 64, retry))
                if not (retry and answer.error is not None and answer.error.code in _EXCHANGE):
                    return answer
            except ValueError as problem:
                self._link.clear()  # what else the damaged answer had to say is not worth hearing
                if not retry:
                    raise DataCorrupt(self._device, f"{problem}.") from problem
                repeated(self._device, problem)
            retry = False

    def drain_errors(self) -> tuple[ScpiError, ...]:
        """Empties the error queue; oldest first."""
        errors: list[ScpiError] = []
        while len(errors) <= _QUEUE_LENGTH:
            error = self._next_error()
            if error.code == 0:
                return tuple(errors)
            errors.append(error)
        raise ProtocolError(self._device, f"its error queue does not end ({errors[-1]}).")

    def _ask(self, message: bytes, expected: int, retry: bool) -> bytes:
        try:
            body, error = split_error(self._retried(message + b";:SYST:ERR?\n", expected, retry))
        except ValueError as problem:
            self._link.clear()
            if retry:
                repeated(self._device, problem)
                return self._ask(message, expected, False)
            raise ProtocolError(self._device, f"{problem}.") from problem
        if error is None:
            return body
        errors = (error, *self.drain_errors())
        if retry and {each.code for each in errors} <= _EXCHANGE:
            repeated(self._device, errors[0])
            return self._ask(message, expected, False)
        raise ErrorsReported(self._device, message[:60].decode("ascii", "replace"), errors)

    def _retried(self, message: bytes, expected: int, retry: bool) -> bytes:
        try:
            return self._link.ask(message, self.timeout_s, expected)
        except (DeviceTimeout, ProtocolError) as problem:
            if not retry:
                raise
            repeated(self._device, problem.what)
            return self._link.ask(message, self.timeout_s, expected)

    def _next_error(self) -> ScpiError:
        """Each is told once: where its report is damaged, the next one is asked for."""
        message = b"SYST:ERR?\n"
        try:
            return decode_error(self._retried(message, 256, True))
        except ValueError:
            self._link.clear()
        try:
            return decode_error(self._link.ask(message, self.timeout_s, 256))
        except ValueError as problem:
            self._link.clear()
            raise ProtocolError(self._device, f"{problem}.") from problem
