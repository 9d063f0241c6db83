"""The SCPI front of a simulated instrument: messages into units, headers into handlers, and the error queue.

An error in one unit does not cancel the units behind it, so that a message that ends in `SYST:ERR?` is always answered.
"""

from collections import deque
from collections.abc import Callable, Mapping

ERROR_TEXTS = {
    -102: "Syntax error",
    -109: "Missing parameter",
    -113: "Undefined header",
    -200: "Execution error",
    -213: "Init ignored",
    -221: "Settings conflict",
    -222: "Data out of range",
    -230: "Data corrupt or stale",
    -350: "Queue overflow",
    -410: "Query INTERRUPTED",
    -420: "Query UNTERMINATED",
    -430: "Query DEADLOCKED",
    101: "Over-count trip latched",
    102: "Interlock open",
    103: "Sync missing",
    104: "Slot overrun",
    105: "Watchdog",
}
_LONG_FORMS = {
    "SYSTEM": "SYST", "ERROR": "ERR", "INPUT": "INP", "LEVEL": "LEV", "ACQUIRE": "ACQ", "POINTS": "POIN",
    "DWELL": "DWEL", "STATUS": "STAT", "OUTPUT": "OUTP", "SHUTTER": "SHUT", "ABORT": "ABOR", "INITIATE": "INIT",
    "HISTOGRAM": "HIST", "OFFSET": "OFFS", "FORMAT": "FORM", "TRIGGER": "TRIG", "SOURCE": "SOUR", "NUMBERS": "NUMB",
    "BLANKING": "BLAN", "PROTECTION": "PROT", "CLEAR": "CLE", "COUNTS": "COUN", "WINDOW": "WIND", "MARKERS": "MARK",
}  # fmt: skip
Handler = Callable[[bytes], bytes | None]


class ScpiFault(Exception):
    """The unit under way is refused with this error code."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"{code} {ERROR_TEXTS[code]}")


class ErrorQueue:
    """First in, first out, 16 deep; the last place turns into -350 when more come (SCPI 1999.0, 21.8.1)."""

    def __init__(self) -> None:
        self._codes: deque[int] = deque()

    def __len__(self) -> int:
        return len(self._codes)

    def push(self, code: int) -> None:
        """Adds an error; the last place of a full queue says -350."""
        if len(self._codes) >= 16:
            self._codes[-1] = -350
        else:
            self._codes.append(code)

    def pop(self) -> bytes:
        """The oldest entry as `SYST:ERR?` answers it, or 0."""
        if not self._codes:
            return b'0,"No error"'
        code = self._codes.popleft()
        return f'{code},"{ERROR_TEXTS[code]}"'.encode()

    def clear(self) -> None:
        """`*CLS`."""
        self._codes.clear()


def split_units(message: bytes) -> list[bytes]:
    """The program message units of a message, its terminator taken off; blocks and strings are kept whole.

    Raises `ScpiFault(-102)` for a block or string that does not end.
    """
    if b"#" not in message and b'"' not in message:
        return message.rstrip(b"\n").split(b";")
    units, start, at = [], 0, 0
    while at < len(message):
        character = message[at : at + 1]
        if character == b"#":
            digit = message[at + 1 : at + 2]
            if not digit.isdigit() or digit == b"0" or not (size := message[at + 2 : at + 2 + int(digit)]).isdigit():
                raise ScpiFault(-102)
            at += 2 + int(digit) + int(size)
            if at > len(message):
                raise ScpiFault(-102)
        elif character == b'"':
            at = message.find(b'"', at + 1) + 1
            if at == 0:
                raise ScpiFault(-102)
        elif character in b";\n":
            units.append(message[start:at])
            at += 1
            start = at
        else:
            at += 1
    if start < len(message):
        units.append(message[start:])
    return units


class ScpiParser:
    """Finds the handler of each unit, in short or long form, relative to the unit before it or absolute."""

    def __init__(self, handlers: Mapping[str, Handler]) -> None:
        self._handlers = handlers
        self._found: dict[tuple[str, bytes], tuple[Handler, str]] = {}

    def execute(self, message: bytes, refuse: Callable[[int], None]) -> bytes:
        """Runs every unit; the answers joined, empty when there are none. `refuse` is told every error code."""
        answers = []
        path = ""
        try:
            units = split_units(message)
        except ScpiFault as fault:
            refuse(fault.code)
            return b""
        for unit in units:
            header, _, argument = unit.strip(b" \t\r").partition(b" ")
            if not header:
                continue
            try:
                handler, path = self._find(header, path)
                answer = handler(argument.strip(b" ") if argument[:1] != b"#" else argument)
            except ScpiFault as fault:
                refuse(fault.code)
                continue
            if answer is not None:
                answers.append(answer)
        return b";".join(answers) + b"\n" if answers else b""

    def _find(self, header: bytes, path: str) -> tuple[Handler, str]:
        found = self._found.get((path, header))
        if found is None:
            try:
                words = header.decode("ascii").upper()
            except UnicodeDecodeError:
                raise ScpiFault(-102) from None
            short = ":".join(self._short(word) for word in words.lstrip(":").split(":"))
            relative = path + short if path and not words.startswith((":", "*")) else short
            name = relative if relative in self._handlers else short
            if name not in self._handlers:
                raise ScpiFault(-113)
            parent = path if name.startswith("*") else name.rpartition(":")[0]
            found = self._found[path, header] = self._handlers[name], parent + ":" if parent else ""
        return found

    def _short(self, word: str) -> str:
        query = word.endswith("?")
        word = word.rstrip("?")
        return _LONG_FORMS.get(word, word) + ("?" if query else "")


def integer(argument: bytes, low: int, high: int) -> int:
    """A decimal number without a fraction, within [low, high]."""
    if not argument:
        raise ScpiFault(-109)
    try:
        number = float(argument)
    except ValueError:
        raise ScpiFault(-102) from None
    if not (low <= number <= high):
        raise ScpiFault(-222)
    if number != int(number):
        raise ScpiFault(-222)
    return int(number)


def word(argument: bytes, choices: tuple[str, ...]) -> str:
    """One of the words, in capitals."""
    if not argument:
        raise ScpiFault(-109)
    chosen = argument.decode("ascii", "replace").upper()
    if chosen not in choices:
        raise ScpiFault(-222)
    return chosen


def block(argument: bytes) -> bytes:
    """The payload of a definite block."""
    if not argument:
        raise ScpiFault(-109)
    if argument[:1] != b"#" or not argument[1:2].isdigit():
        raise ScpiFault(-102)
    first = 2 + int(argument[1:2])
    payload = argument[first:]
    if argument[2:first] != str(len(payload)).encode().zfill(first - 2):
        raise ScpiFault(-102)
    return payload
