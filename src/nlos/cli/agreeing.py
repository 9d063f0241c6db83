"""Questions to somebody at the terminal; where nobody is there, the answer is no."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from nlos.by_hand.stops import CTRL_Z, STOP
from nlos.cli.terminal import terminal
from nlos.drivers.exit_paths import light_may_be_on

try:
    import termios
except ImportError:  # Windows
    termios = None  # type: ignore[assignment]


def somebody_is_there() -> bool:
    """Whether a person can read a question and answer it."""
    return sys.stdin.isatty() and sys.stderr.isatty()


@contextmanager
def asked_again(ask: Callable[[], None]) -> Iterator[None]:
    """While the block waits for an answer Ctrl-Z stops the program as it does any other, and `ask` follows once it goes
    on. An open bench ends the program there, because a stopped one can close nothing; its light is off at a question.
    """
    if CTRL_Z is None or STOP is None or threading.current_thread() is not threading.main_thread():
        yield
        return

    def on_signal(number: int, frame: FrameType | None) -> None:
        if light_may_be_on() and callable(before):
            before(number, frame)
        else:
            os.kill(os.getpid(), STOP)
            ask()

    before = signal.signal(CTRL_Z, on_signal)
    try:
        yield
    finally:
        signal.signal(CTRL_Z, before)


def answer(question: str) -> str | None:
    """What was typed; None at the end of the input."""

    def ask() -> None:
        terminal.log(question, -9)

    try:
        with asked_again(ask):
            forget_what_was_typed()
            ask()
            return typed().lower()
    except EOFError:
        return None


def forget_what_was_typed() -> None:
    """Just before a question whose answer gives light, or moves a mirror: a key that was pressed before it answers
    nothing. A terminal forgets by itself at Ctrl-C alone."""
    if termios is not None:
        with suppress(termios.error, OSError, ValueError):  # the terminal is gone, or there is none
            termios.tcflush(sys.stdin, termios.TCIFLUSH)


def typed() -> str:
    """A line from the terminal, without what surrounds it; keys of another encoding are text, too. Raises `EOFError` at
    the end of the input."""
    try:
        return input().strip()
    except UnicodeDecodeError:
        return "?"


def agrees(what: str, word: str = "light") -> bool:
    """Whether somebody typed the word after having read what it means."""
    return somebody_is_there() and answer(f'{what} Type "{word}" to agree, Enter to stop here.') == word
