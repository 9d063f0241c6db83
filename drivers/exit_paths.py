"""Every way out of a program that holds a laser bench: signals, the end of the interpreter, and a `with` block."""

import atexit
import os
import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))


class ExitPaths:
    """Calls `shut_light` within SIGINT, SIGTERM and SIGHUP before whatever else the program does about them, and
    `close` when the block is left or the interpreter ends. Neither SIGKILL nor a power cut passes here: against those
    stand the instrument's watchdog and the interlock.

    A signal that would have killed the process raises `SystemExit(128 + number)` instead, so that every `with` and
    `finally` on the way runs. Signals that arrive while the bench is closing wait until it is closed.
    """

    def __init__(self, shut_light: Callable[[str], None], close: Callable[[], None]) -> None:
        self._shut_light, self._close = shut_light, close
        self._process = os.getpid()
        self._previous: dict[int, Any] = {}
        self._closing = False
        self._waiting: list[int] = []

    def __enter__(self) -> "ExitPaths":
        atexit.register(self._close_once)
        if threading.current_thread() is threading.main_thread():
            for number in _SIGNALS:
                # A signal that is ignored (nohup) or handled outside Python stays so.
                if signal.getsignal(number) not in (signal.SIG_IGN, None):
                    self._previous[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._close_once()
        finally:
            atexit.unregister(self._close_once)
            for number, previous in self._previous.items():
                # Whoever took the signal over meanwhile keeps it.
                if signal.getsignal(number) == self._on_signal:
                    signal.signal(number, previous)
        for number in self._waiting:
            self._go_on(number, None)

    def _close_once(self) -> None:
        if self._closing or os.getpid() != self._process:
            return
        self._closing = True
        self._close()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if os.getpid() == self._process:
            if self._closing:
                self._waiting.append(number)
                return
            self._shut_light(signal.Signals(number).name)
        self._go_on(number, frame)

    def _go_on(self, number: int, frame: FrameType | None) -> None:
        previous = self._previous[number]
        if callable(previous):
            previous(number, frame)
        else:
            raise SystemExit(128 + number)
