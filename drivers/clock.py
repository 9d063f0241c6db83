"""Where time comes from: the computer's clock, or the simulated bench's, which runs ahead of it."""

import time
from typing import Protocol

_AWAKE_OR_NOT: int | None = getattr(time, "CLOCK_BOOTTIME", None)


class Clock(Protocol):
    """Seconds on a monotonic clock of arbitrary origin. Everything that waits is given one."""

    passes_by_itself: bool
    """Whether time goes on while nobody waits for it."""

    def now(self) -> float:
        """Seconds since some moment."""
        ...

    def sleep(self, seconds: float) -> None:
        """Returns when so many seconds have passed; at once for none or less."""
        ...


class SystemClock:
    """The computer's monotonic clock, which no setting of the time of day moves. Where the system has one (Linux) it is
    the one that goes on while the computer sleeps: light that was on then is older than it looks."""

    passes_by_itself = True

    def now(self) -> float:
        return time.monotonic() if _AWAKE_OR_NOT is None else time.clock_gettime(_AWAKE_OR_NOT)

    def sleep(self, seconds: float) -> None:
        if seconds > 0:
            time.sleep(seconds)


class VirtualClock:
    """The simulated bench's clock: sleeping moves it on and costs nothing.

    Time passes only when somebody waits for it - a dwell, a settling mirror, a byte on its way - so that a simulated
    scan reports the duration of the real one.
    """

    passes_by_itself = False

    def __init__(self) -> None:
        self._now_s = 0.0

    def now(self) -> float:
        return self._now_s

    def sleep(self, seconds: float) -> None:
        if seconds > 0:
            self._now_s += seconds

    def advance_to(self, when_s: float) -> None:
        """Moves on to `when_s`; a moment already past leaves the clock where it is."""
        self._now_s = max(self._now_s, when_s)


class RealTimeClock(VirtualClock):
    """A simulated bench's clock that keeps the computer's time: for a person who turns a knob and looks."""

    passes_by_itself = True

    def __init__(self) -> None:
        self._began_s = time.monotonic()

    def now(self) -> float:
        return time.monotonic() - self._began_s

    def sleep(self, seconds: float) -> None:
        if seconds > 0:
            time.sleep(seconds)

    def advance_to(self, when_s: float) -> None:
        """Waits until then; not at all for a moment already past."""
        self.sleep(when_s - self.now())
