"""Keys as they are pressed, without Enter; Ctrl-C and Ctrl-Z stay the signals that they are."""

import os
import select
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from nlos.by_hand.stops import Stops

try:
    import termios
    import tty
except ImportError:  # Windows
    termios = None  # type: ignore[assignment]

_ESCAPES = {
    b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left",
    b"\x1bOA": "up", b"\x1bOB": "down", b"\x1bOC": "right", b"\x1bOD": "left",
}  # fmt: skip
_NAMES = {b" ": "space", b"\r": "enter", b"\n": "enter", b"\x7f": "backspace", b"\b": "backspace", b"\x1b": "escape",
          b"\t": "tab"}  # fmt: skip


def decoded(data: bytes) -> list[str]:
    """The keys that a terminal's bytes mean; what is none of ours is skipped."""
    keys: list[str] = []
    while data:
        if data[:3] in _ESCAPES:
            keys.append(_ESCAPES[data[:3]])
            data = data[3:]
        elif data[:2] == b"\x1b[" or data[:2] == b"\x1bO":  # another key's sequence: up to its last letter
            end = next((k for k in range(2, len(data)) if 0x40 <= data[k] <= 0x7E), len(data) - 1)
            data = data[end + 1 :]
        else:
            one = data[:1]
            if one in _NAMES:
                keys.append(_NAMES[one])
            elif 0x20 < one[0] < 0x7F:
                keys.append(one.decode())
            data = data[1:]
    return keys


class Keys:
    """`pressed` never waits. Off a terminal nothing is ever pressed."""

    def __init__(self, file: int | None) -> None:
        self._file = file

    @property
    def there(self) -> bool:
        """Whether somebody can press one."""
        return self._file is not None

    def pressed(self) -> list[str]:
        """What was pressed since the last call, in order. The end of the input is a `q`."""
        if self._file is None or not select.select([self._file], [], [], 0)[0]:
            return []
        try:
            data = os.read(self._file, 1024)
        except OSError:  # the terminal hung up
            data = b""
        return decoded(data) if data else ["q"]


@contextmanager
def keys_of_terminal(stops: Stops) -> Iterator[Keys]:
    """The terminal's keys until the block is left, then the terminal as it was; so while the program is stopped."""
    if termios is None or not (sys.stdin.isatty() and sys.stdout.isatty()):
        yield Keys(None)
        return
    file = sys.stdin.fileno()
    before = termios.tcgetattr(file)

    def as_it_was() -> None:
        with suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(file, termios.TCSADRAIN, before)

    def as_pressed() -> None:
        with suppress(termios.error):
            tty.setcbreak(file)

    # A program that is stopped because it reads in the background cannot shut the light.
    reads_before = signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    try:
        with stops.around(as_it_was, as_pressed):
            as_pressed()
            yield Keys(file)
    finally:
        as_it_was()
        signal.signal(signal.SIGTTIN, reads_before)
