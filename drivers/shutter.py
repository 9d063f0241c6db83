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

    @property
    def on_counter(self) -> bool:
        """Whether it hangs on an output of the counter: only then can the counter's watchdog close it."""
        ...

    def open(self) -> None:
        """Opens and verifies by read-back. Raises `SafetyTrip` where the interlock is open or a trip is latched."""
        ...

    def close(self) -> None:
        """Closes and verifies by read-back. Never waits longer than 100 ms for a busy link, may be called from a signal
        handler, repeatedly, and after any error. Raises `DeviceFault` where the feedback still says open."""
        ...

    def state(self) -> ShutterState:
        """What was commanded, and what a contact says of it where there is one."""
        ...


class ShutterLine(Protocol):
    """A controller with a TTL output that is wired to the shutter; `triggerscope` is one."""

    def set_shutter_line(self, is_open: bool) -> None:
        """Drives the output; returns when the controller confirms."""
        ...


class TtlShutter:
    """A shutter on a mirror controller's TTL output. Nothing reads back whether it moved, nor the interlock."""

    on_counter = False

    def __init__(self, line: ShutterLine) -> None:
        self._line = line
        self._commanded_open = False

    def open(self) -> None:
        self._commanded_open = True
        self._line.set_shutter_line(True)

    def close(self) -> None:
        self._line.set_shutter_line(False)
        self._commanded_open = False

    def state(self) -> ShutterState:
        """As commanded: nothing reads back."""
        return ShutterState(self._commanded_open, None, None)


class NoShutter:
    """A bench without a shutter that this program could close: the light is a person's business."""

    on_counter = False

    def __init__(self) -> None:
        self._commanded_open = False

    def open(self) -> None:
        self._commanded_open = True

    def close(self) -> None:
        self._commanded_open = False

    def state(self) -> ShutterState:
        """As commanded: there is none."""
        return ShutterState(self._commanded_open, None, None)
