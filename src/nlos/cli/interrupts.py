"""Ctrl-C during a scan: pause on a terminal, end without one. The bench shuts the light before any of this runs."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any

from nlos.cli.terminal import terminal
from nlos.drivers.exit_paths import signal_soon

if TYPE_CHECKING:
    from nlos.acquisition.scanning.control import ScanControl


_watched = False


def never_lose_an_interrupt() -> None:
    """Python prints and forgets a Ctrl-C that falls into a finaliser or a weak reference's callback: it comes again."""
    global _watched
    _watched = True
    before = sys.unraisablehook

    def hook(lost: Any) -> None:
        if isinstance(lost.exc_value, KeyboardInterrupt):
            signal_soon(signal.SIGINT)
        else:
            before(lost)

    sys.unraisablehook = hook


def ignore_interrupts() -> None:
    """From now on the process is ending, and says what it has to say. Does nothing in another program's process."""
    if _watched:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


class Interrupts:
    """Turns SIGINT into a wish to pause. `seen` says whether anybody pressed Ctrl-C."""

    def __init__(self) -> None:
        self.seen = False
        self._control: ScanControl | None = None
        self._asking = False

    @contextmanager
    def caught(self) -> Iterator["Interrupts"]:
        """SIGINT comes here until the block ends. Enter this before the bench is opened: the bench's own handler,
        which shuts the light, then runs first and hands the signal on."""
        previous = signal.signal(signal.SIGINT, self._on_signal)
        try:
            yield self
        finally:
            signal.signal(signal.SIGINT, previous)

    def pauses(self, control: "ScanControl") -> None:
        """From now on Ctrl-C pauses this scan."""
        self._control = control

    def ask(self, why: str) -> bool:
        """Waits for Enter (True) or a second Ctrl-C (False); without a terminal the answer is False."""
        if not (sys.stdin.isatty() and sys.stderr.isatty()):
            return False
        terminal.log(f"paused ({why}); the shutter is closed. Enter resumes, Ctrl-C ends the scan.", -9)
        self._asking = True
        try:
            input()
        except (KeyboardInterrupt, EOFError):
            return False
        finally:
            self._asking = False
        self.seen = False
        return True

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        again, self.seen = self.seen, True
        if self._asking or self._control is None or again:
            raise KeyboardInterrupt
        self._control.interrupt("Ctrl-C")
