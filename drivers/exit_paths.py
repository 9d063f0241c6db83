"""Every way out of a program that holds a laser bench: signals, the end of the interpreter, and a `with` block."""

import _thread
import atexit
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any

_ENDS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK", "SIGQUIT", "SIGTSTP", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGVTALRM",
         "SIGPROF", "SIGXCPU", "SIGPWR", "SIGIO", "SIGSTKFLT", "SIGABRT", "SIGTRAP", "SIGSYS", "SIGTTIN")  # fmt: skip
_REAL_TIME = range(signal.SIGRTMIN, signal.SIGRTMAX + 1) if hasattr(signal, "SIGRTMIN") else range(0)
_SIGNALS = (*(getattr(signal, name) for name in _ENDS if hasattr(signal, name)), *_REAL_TIME)
"""All that end a program, or stop it (Ctrl-Z), unless it is told otherwise: a stopped one cannot close anything.
SIGABRT is how systemd ends a service whose watchdog ran out."""
_BY_PEOPLE = {getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)}
_UNHEEDED = tuple(getattr(signal, name) for name in ("SIGTTOU",) if hasattr(signal, name))
"""It would stop a program in the background that prints (`stty tostop`): it prints all the same."""
_READS, _STOP = (getattr(signal, name, None) for name in ("SIGTTIN", "SIGSTOP"))
"""What comes to who reads in the background, and what stops it; neither on Windows."""
_IMPORT = "<frozen importlib._bootstrap>"
_SOON_S = 0.005
_ENDING_TAKES_S = 20.0
"""A program that was told to end is told again only after so long: what it still does is bring things to an end."""

_open: list["ExitPaths"] = []
_told_to_end = False


def name_of(number: int) -> str:
    """What a signal is called: SIGINT, or SIGRTMIN+3."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"SIGRTMIN+{number - signal.SIGRTMIN}"


def signal_soon(number: int, after_s: float = _SOON_S) -> None:
    """Raises a signal from another thread, a moment later: what the main thread is in the middle of is over by then."""

    def raise_it() -> None:
        time.sleep(after_s)
        main = threading.main_thread().ident
        if main is not None and hasattr(signal, "pthread_kill"):
            signal.pthread_kill(main, number)  # wakes it, too, where it sleeps
        else:
            signal.raise_signal(number)

    _thread.start_new_thread(raise_it, ())


def loads_a_module(frame: FrameType | None, top: FrameType | None = None) -> bool:
    """Whether an import is under way between the frame `top`, or the program's first one, and `frame`."""
    while frame is not None and frame is not top:
        if frame.f_code.co_filename == _IMPORT:
            return True
        frame = frame.f_back
    return False


def a_bench_is_open() -> bool:
    """Then a signal shuts its light before anything else, and waits where something is `undisturbed`."""
    return bool(_open)


def light_may_be_on() -> bool:
    """Whether the shutter of a bench that is open may be: then nothing is waited for that has no deadline."""
    return any(paths.lit() for paths in _open)


def a_bench_is_closing() -> bool:
    """Then a signal waits until it is closed, so nothing on the way is waited for that has no deadline."""
    return any(paths.closing for paths in _open)


def close_benches() -> None:
    """Closes every bench that is still open, as the end of the interpreter does, where that will not come."""
    for paths in list(_open):
        paths.close_once()


def was_told_to_end() -> bool:
    """Whether a signal has ended this program: what it does since then brings things to an end."""
    return _told_to_end


def tell_to_end(told: bool = True) -> None:
    """Says so, just before a signal's handler raises what ends the program; False where another command begins."""
    global _told_to_end
    _told_to_end = told


def _ends_the_light(handler: Any) -> bool:
    return handler is signal.default_int_handler or getattr(handler, "__func__", None) is ExitPaths._on_signal


@contextmanager
def undisturbed() -> Iterator[None]:
    """While the block runs, a signal shuts the light and waits: for the few steps that must not be cut in two, such as
    a file's last ones. Does nothing where no bench is open."""
    holding = list(_open)
    for paths in holding:
        paths.held += 1
    try:
        yield
    finally:
        for paths in holding:
            paths.held -= 1
        for paths in reversed(holding):
            paths.deliver()


@contextmanager
def whole(drives_the_shutter: bool) -> Iterator[None]:
    """The opening of a device. Of one that drives the shutter it is `undisturbed` until it is dark, whatever light a
    program that was killed left on; each of its exchanges has a deadline."""
    if drives_the_shutter:
        with undisturbed():
            yield
    else:
        yield


class ExitPaths:
    """Calls `shut_light` within every signal that ends or stops a program before whatever else the program does about
    it, and `close` when the block is left or the interpreter ends. Neither SIGKILL and SIGSTOP, a crash of the
    interpreter (SIGSEGV) nor a power cut passes here: against those stand the instrument's watchdog and the interlock.

    A signal that would have killed or stopped the process raises `SystemExit(128 + number)` instead, so that every
    `with` and `finally` on the way runs. SIGTTIN, which comes to who reads from its terminal in the background, stops a
    program whose light is off, as it does any other. The end happens once: signals that follow, and those that arrive
    while the bench is closing or while something is `undisturbed`, shut the light and wait. An end that Python
    swallowed, because it fell into a finaliser, is raised again.
    """

    def __init__(
        self, shut_light: Callable[[str], None], close: Callable[[], None], lit: Callable[[], bool] = lambda: False
    ) -> None:
        self._shut_light, self._close, self.lit = shut_light, close, lit
        self._process = os.getpid()
        self._previous: dict[int, Any] = {}
        self.closing = self._shutting = self._raising_again = False
        self._waiting: list[int] = []
        self._ending: BaseException | None = None
        self._ending_s = 0.0
        self._unraisable = sys.unraisablehook
        self._named: set[int] = set()
        self.held = 0
        """How many blocks want to be `undisturbed`."""

    def __enter__(self) -> "ExitPaths":
        atexit.register(self.close_once)
        if threading.current_thread() is threading.main_thread():
            for number in (*_SIGNALS, *_UNHEEDED):
                # A signal that is ignored (nohup) or handled outside Python stays so.
                if signal.getsignal(number) not in (signal.SIG_IGN, None):
                    self._previous[number] = signal.signal(number, self._handler(number))
            self._unraisable, sys.unraisablehook = sys.unraisablehook, self._raise_again
            _open.append(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close_once()
        finally:
            atexit.unregister(self.close_once)
            if self in _open:
                _open.remove(self)
                sys.unraisablehook = self._unraisable
            for number, previous in self._previous.items():
                # Whoever took the signal over meanwhile keeps it.
                if signal.getsignal(number) == self._handler(number):
                    signal.signal(number, previous)
        self.held = 0
        self.closing = False
        if kind is None:  # else the program is on its way out already
            self.deliver()

    def _handler(self, number: int) -> Any:
        return signal.SIG_IGN if number in _UNHEEDED else self._on_signal

    def newly_taken_over(self) -> str:
        """Which of the signals that people and systems end programs by another handler answers since this was entered,
        each named once; empty where none. Another bench's passes them on, Python's own ends whatever is under way."""
        new = sorted(self._previous.keys() & _BY_PEOPLE - self._named)
        new = [number for number in new if not _ends_the_light(signal.getsignal(number))]
        self._named.update(new)
        return ", ".join(map(name_of, new))

    def close_once(self) -> None:
        """Calls `close`, unless that was done."""
        if self.closing or os.getpid() != self._process:
            return
        self.closing = True
        self._close()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if os.getpid() != self._process:
            self._go_on(number, frame)
            return
        if self._raising_again:  # here an exception would be lost once more
            signal_soon(number)
            return
        if self._shutting or self.closing:  # a signal within this handler, or the light is off already
            self._waiting.append(number)
            return
        if _STOP is not None and number == _READS and not light_may_be_on():
            os.kill(os.getpid(), _STOP)
            return
        self._shutting = True
        try:
            self._shut_light(name_of(number))
        finally:
            self._shutting = False
        self._waiting.insert(0, number)
        self.deliver(frame)

    def deliver(self, frame: FrameType | None = None) -> None:
        """Does what the program does about the signals that waited, unless something must not be disturbed."""
        while self._waiting and not (self.held or self.closing or self._shutting):
            self._go_on(self._waiting.pop(0), frame)

    def _go_on(self, number: int, frame: FrameType | None) -> None:
        if self._ending is not None and time.monotonic() - self._ending_s < _ENDING_TAKES_S:
            return
        previous = self._previous[number]
        try:
            if callable(previous):
                previous(number, frame)
            else:
                tell_to_end()
                raise SystemExit(128 + number)
        except BaseException as ending:
            self._ending, self._ending_s = ending, time.monotonic()
            raise

    def _raise_again(self, lost: Any) -> None:
        """Python swallows what is raised within a finaliser or a weak reference's callback: the end comes again."""
        if self._ending is None or lost.exc_value is not self._ending:
            self._unraisable(lost)
            return
        code = getattr(lost.exc_value, "code", None)
        self._ending, self._raising_again = None, True
        signal_soon(code - 128 if isinstance(code, int) and code - 128 in self._previous else signal.SIGINT)
        self._raising_again = False
