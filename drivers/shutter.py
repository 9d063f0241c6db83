"""The laser shutter: closed unless someone is acquiring, commanded and read back."""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class ShutterState:
    """What was commanded, what the feedback contact says, whether the interlock loop is closed; None: not wired."""

    commanded_open: bool
    feedback_open: bool | None
    interlock_closed: bool | None


class LaserShutter(Protocol):
    """Requests and reads back; the hard-wired interlock is the safety device."""

    def open(self) -> None:
        """Opens and verifies by read-back. Raises `SafetyTrip` where the interlock is open or a trip is latched."""
        ...

    def close(self) -> None:
        """Closes and verifies by read-back. Never waits longer than 100 ms for a busy link, may be called from a signal
        handler, repeatedly, and after any error. Raises `DeviceFault` where the feedback still says open."""
        ...

    def state(self) -> ShutterState: ...
