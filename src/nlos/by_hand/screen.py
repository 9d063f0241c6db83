"""A screen that is drawn over ten times a second, and put back as it was found."""

import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TextIO

from nlos.by_hand.stops import Stops
from nlos.cli.escaped import escaped

_ENTER, _LEAVE = "\x1b[?1049h\x1b[?25l\x1b[2J", "\x1b[?25h\x1b[?1049l"


class Screen:
    """`draw` shows lines, cut to the terminal's width and height, in one write."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    @property
    def size(self) -> os.terminal_size:
        return shutil.get_terminal_size((80, 24))

    def draw(self, lines: Sequence[str]) -> None:
        columns, rows = self.size
        shown = "".join(f"{escaped(line)[:columns]}\x1b[K\r\n" for line in lines[: rows - 1])
        self._stream.write(f"\x1b[H{shown}\x1b[J")
        self._stream.flush()


@contextmanager
def screen_of_terminal(stops: Stops) -> Iterator[Screen]:
    """The terminal's second screen until the block is left, or the program is stopped."""
    stream = getattr(sys.stdout, "sent", sys.stdout)

    def write(text: str) -> None:
        stream.write(text)
        stream.flush()

    write(_ENTER)
    try:
        with stops.around(partial(write, _LEAVE), partial(write, _ENTER)):
            yield Screen(stream)
    finally:
        write(_LEAVE)
