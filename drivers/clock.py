"""Where time comes from: the computer's clock, or the simulated bench's, which runs ahead of it."""

import time
from typing import Protocol


class Clock(Protocol):
    """Seconds on a monotonic clock of arbitrary origin. Everything that waits is given one."""

    def now(self) -> float:
        """Seconds since some moment."""
        ...

    def sleep(self, seconds: float) -> None:
        """Returns when so many seconds have passed; at once for none or less."""
        ...


class SystemClock:
    """The computer's monotonic clock."""

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        if seconds > 0:
            time.sleep(seconds)


class VirtualClock:
    """The simulated bench's clock: sleeping moves it on and costs nothing.

    Time passes only when somebody waits for it - a dwell, a settling mirror, a byte on its way - so that a simulated
    scan reports the duration of the real one.
    """

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
