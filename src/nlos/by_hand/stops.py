"""Ctrl-Z with the light in one's hands: it goes off, then the program stops as any other, and goes on in the dark."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from nlos.drivers.exit_paths import light_may_be_on

CTRL_Z, STOP = (getattr(signal, name, None) for name in ("SIGTSTP", "SIGSTOP"))
"""What is asked for, and what nobody can catch; neither on Windows."""
BY_CTRL_Z = "Ctrl-Z in the terminal"
"""Who shut the light then."""


class Stops:
    """The signal is only noted as it comes: whoever looks every 10 ms shuts the light, and stops between two gates,
    for an exchange with an instrument that is cut in two is an error."""

    def __init__(self) -> None:
        self.wanted = self._at_once = False
        self._around: list[tuple[Callable[[], None], Callable[[], None]]] = []

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Ctrl-Z comes here until the block is left."""
        before = None if CTRL_Z is None else signal.signal(CTRL_Z, self._on_signal)
        try:
            yield
        finally:
            if CTRL_Z is not None:
                signal.signal(CTRL_Z, before)

    @contextmanager
    def around(self, leave: Callable[[], None], enter: Callable[[], None]) -> Iterator[None]:
        """While the block runs `leave` comes before a stop, and `enter` after it: a shell wants its terminal back."""
        self._around.append((leave, enter))
        try:
            yield
        finally:
            self._around.pop()

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """While the block waits in the dark, and says nothing to an instrument, a stop need not be waited for."""
        self._at_once = True
        try:
            yield
        finally:
            self._at_once = False

    def stop(self) -> None:
        """Until somebody continues the program; the light has to be off."""
        self.wanted = False
        for leave, _ in reversed(self._around):
            leave()
        if STOP is not None:
            os.kill(os.getpid(), STOP)
        for _, enter in self._around:
            enter()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._at_once and not light_may_be_on():
            self.stop()
        else:
            self.wanted = True
