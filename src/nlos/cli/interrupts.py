"""Ctrl-C: an end between two imports, or a pause of a scan on a terminal, as Ctrl-Z is. A bench shuts its light before
any of it."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any

from nlos.by_hand.stops import BY_CTRL_Z
from nlos.cli.agreeing import asked_again, forget_what_was_typed, typed
from nlos.cli.terminal import terminal
from nlos.drivers.exit_paths import loads_a_module, name_of, signal_soon, tell_to_end

if TYPE_CHECKING:
    from nlos.acquisition.scanning.control import ScanControl


BY_HAND = "Ctrl-C in the terminal"
"""What a recording says of a pause: the bare name of the keys reads as if somebody were to press them."""
_BY_HAND = {"SIGINT": BY_HAND, "SIGTSTP": BY_CTRL_Z}
_PAUSES = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTSTP") if hasattr(signal, name))
"""Ctrl-Z would stop the program where it is, with the light on."""
_AGAIN_S = 0.02
_BY_SIGNAL = 128

_watched = False


def end_at_interrupts() -> None:
    """From now on Ctrl-C raises `KeyboardInterrupt` in whoever calls this, but never within an import that began since:
    what a module in C makes of it there is printed as an error of the program, or forgotten. Once the import is over it
    comes again."""
    top = sys._getframe(1)
    signal.signal(signal.SIGINT, lambda number, frame: interrupt(frame, top))


def interrupt(frame: FrameType | None, top: FrameType | None = None) -> None:
    """Raises `KeyboardInterrupt`; where a frame between `frame` and `top` loads a module, a little later."""
    if loads_a_module(frame, top):
        signal_soon(signal.SIGINT, _AGAIN_S)
        return
    tell_to_end()
    raise KeyboardInterrupt


def end_in_order_at_sigterm() -> None:
    """From now on SIGTERM raises `SystemExit`, as it does while a bench is open, and comes again once an import is
    over: who asked for a document is told what became of the command. Does nothing in another program's process."""
    if not _watched or threading.current_thread() is not threading.main_thread():
        return
    process, top = os.getpid(), sys._getframe(1)

    def end(number: int, frame: FrameType | None) -> None:
        if os.getpid() != process:  # a child that was forked has nothing to say
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        elif loads_a_module(frame, top):
            signal_soon(number, _AGAIN_S)
        else:
            tell_to_end()
            raise SystemExit(128 + number)

    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, end)


def end_at_once_at_sigterm() -> None:
    """All is done and said: an exception in what Python still tidies up would only be printed as an error."""
    if _watched and callable(signal.getsignal(signal.SIGTERM)):
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def never_lose_an_interrupt() -> None:
    """Python prints and forgets a Ctrl-C that falls into a finaliser or a weak reference's callback, and the end that
    another signal asks for: it comes again."""
    global _watched
    _watched = True
    before = sys.unraisablehook

    def hook(lost: Any) -> None:
        code = getattr(lost.exc_value, "code", None)
        if isinstance(lost.exc_value, KeyboardInterrupt):
            signal_soon(signal.SIGINT)
        elif isinstance(lost.exc_value, SystemExit) and isinstance(code, int) and code > _BY_SIGNAL:
            signal_soon(code - _BY_SIGNAL)
        else:
            before(lost)

    sys.unraisablehook = hook


def ignore_interrupts() -> None:
    """From now on the process is ending, and says what it has to say. Does nothing in another program's process."""
    if _watched:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def served_until_told(stop: Callable[[], object]) -> Iterator[None]:
    """SIGINT and SIGTERM call `stop` until the block ends in order; then they end the command, with 130 or 143."""
    told = list[int]()

    def ended(number: int, frame: FrameType | None) -> None:
        told.append(number)
        stop()

    previous = {number: signal.signal(number, ended) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
    if told:
        raise KeyboardInterrupt if told[0] == signal.SIGINT else SystemExit(_BY_SIGNAL + told[0])


class Interrupts:
    """Turns SIGINT and SIGTSTP into a wish to pause. `seen` says whether anybody pressed Ctrl-C or Ctrl-Z."""

    def __init__(self) -> None:
        self.seen = False
        self._control: ScanControl | None = None
        self._asking = False
        self._light, self._at_terminal = "", True

    @contextmanager
    def caught(self) -> Iterator["Interrupts"]:
        """SIGINT and SIGTSTP come here until the block ends. Enter this before the bench is opened: the bench's own
        handler, which shuts the light, then runs first and hands the signal on."""
        previous = {number: signal.signal(number, self._on_signal) for number in _PAUSES}
        try:
            yield self
        finally:
            for number, handler in previous.items():
                signal.signal(number, handler)

    def pauses(self, control: "ScanControl", shuttered: bool) -> None:
        """From now on Ctrl-C pauses this scan, in the dark where there is a shutter."""
        self._control = control
        self._at_terminal = sys.stdin.isatty()
        self._light = "the shutter is closed" if shuttered else "the laser is as it was, this bench has no shutter"

    def ask(self, why: str, over: bool = False) -> bool:
        """Waits for Enter (True) or a second Ctrl-C (False); without a terminal the answer is False. A program that was
        stopped meanwhile asks again. Of a scan that is `over` a person has nothing left to pause, and is not asked."""
        if not (sys.stdin.isatty() and sys.stderr.isatty()):
            return False
        if over and why in _BY_HAND.values():
            self.seen = False
            return True
        how = f"by {why}" if why in _BY_HAND.values() else f"({why})"

        def ask() -> None:
            terminal.log(f"paused {how}; {self._light}. Enter resumes, Ctrl-C ends the scan.", -9)

        self._asking = True
        try:
            with asked_again(ask):
                forget_what_was_typed()
                ask()
                while typed():
                    terminal.log("Enter alone resumes, Ctrl-C ends the scan.", -9)
        except (KeyboardInterrupt, EOFError):
            return False
        finally:
            self._asking = False
        self.seen = False
        return True

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        again, self.seen = self.seen, True
        if self._asking or self._control is None or again:
            interrupt(frame)
            return
        name = name_of(number)
        self._control.interrupt(_BY_HAND.get(name, name) if self._at_terminal else name)
