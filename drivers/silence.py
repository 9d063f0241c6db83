"""Light that nobody looks after: shut off where the program that asked for it hangs in a disk, a pipe or a driver.

What a counter's watchdog does in the instrument, a thread does here, for a shutter that no instrument watches. It does
not help against a crash, SIGKILL and SIGSTOP, or a computer that freezes, nor where threads are no threads.
"""

import contextlib
import logging
import threading
from collections.abc import Callable
from types import BuiltinFunctionType

from nlos.drivers.clock import Clock
from nlos.drivers.device_model import WireLog
from nlos.drivers.wire_log import unfailing

_log = logging.getLogger(__name__)
COROUTINES = (
    "this program's threads are coroutines (gevent, eventlet): if one of them hangs, the shutter stays open. Scan in a "
    "program without."
)
_LOOKS = 8
"""So often within the longest silence somebody looks."""


class Silence:
    """Between `lit` and `dark`, every exchange with an instrument is a sign of life, so is every `heard`. Where none
    comes for `longest_s`, `broken_off` says so from then on, and `shut` is called until it is dark.

    No locks, because light is shut within signal handlers too. On a clock that passes only while somebody waits there
    is no thread: the next sign of life finds the silence.
    """

    def __init__(self, clock: Clock, longest_s: float) -> None:
        self._clock, self.longest_s = clock, longest_s
        self.shut: Callable[[], object] = lambda: None
        self.broken_off = ""
        self._lit = False
        self._heard_s = clock.now()
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def is_speaking(self) -> bool:
        """Whether it is its own thread that asks."""
        return threading.current_thread() is self._thread

    def lit(self) -> None:
        """Light comes on."""
        self._heard_s, self._lit = self._clock.now(), True
        if self._thread is None and self._clock.passes_by_itself:
            if takes_turns():
                _log.warning(COROUTINES)
            self._thread = threading.Thread(target=self._watch, name="light without a sign of life", daemon=True)
            self._thread.start()

    def dark(self) -> None:
        """The light is off."""
        self._lit = False

    def heard(self) -> None:
        """A sign of life, which may come too late."""
        self._look()
        self._heard_s = self._clock.now()

    def end(self) -> None:
        """There will be no light any more."""
        self._ended.set()

    def _look(self) -> bool:
        """Whether there is light that nobody looks after."""
        if self._lit and not self.broken_off and self._clock.now() - self._heard_s > self.longest_s:
            self.broken_off = f"nothing was heard from this program for {self.longest_s:g} s with the light on"
        return self._lit and bool(self.broken_off)

    def _watch(self) -> None:
        while not self._ended.wait(self.longest_s / _LOOKS):
            if self._look():
                with contextlib.suppress(Exception):  # it is tried again, whatever the failure
                    self.shut()


def takes_turns() -> bool:
    """Whether this program's threads are coroutines (gevent, eventlet): while one hangs, none of the others runs."""
    return not isinstance(threading.get_ident, BuiltinFunctionType)


def heard_by(silence: Silence | None, wire_log: WireLog | None) -> WireLog | None:
    """The same wire log, where every exchange is a sign of life. What the thread says itself is not kept: the disk of
    the log may be what hangs."""
    if silence is None:
        return wire_log
    kept: dict[str, WireLog | None] = {}

    def log(device: str, direction: str, data: bytes) -> None:
        silence.heard()
        each = kept.setdefault(device, unfailing(wire_log))
        if each is not None and not silence.is_speaking:
            each(device, direction, data)

    return log
