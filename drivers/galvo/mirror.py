"""What every mirror controller does: aim the beam, within limits that are checked before anything is sent."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from nlos.drivers.identity import DeviceIdentity


@dataclass(frozen=True)
class MirrorAngles:
    """Optical deflection (twice the mechanical) in radians, +x right and +y up as seen by the scanner."""

    x_rad: float
    y_rad: float


class GalvoMirror(Protocol):
    """A two-axis mirror. Positions outside the limits raise `LimitError`; nothing is ever clipped.

    After any error during a move the axis state is unknown: further moves raise until `close()`, or, after a
    `MirrorDisturbed`, until `park()`.
    """

    @property
    def identity(self) -> DeviceIdentity: ...

    @property
    def max_sequence(self) -> int:
        """How many positions `load` takes in one go; 0 where the controller cannot step by itself."""
        ...

    def check(self, angles: MirrorAngles) -> None:
        """Raises `LimitError` when `angles` cannot be reached. Sends nothing."""
        ...

    def settle_s(self, start: MirrorAngles, end: MirrorAngles) -> float:
        """Expected time from the command until the beam is still, from the settle model."""
        ...

    def begin_move(self, angles: MirrorAngles) -> None:
        """Commands the move and returns once the controller has accepted it."""
        ...

    def wait_settled(self) -> None:
        """Returns when the last commanded move has settled. Raises `SettleTimeout`."""
        ...

    def move_to(self, angles: MirrorAngles) -> None:
        """`begin_move`, then `wait_settled`."""
        ...

    def load(self, sequence: Sequence[MirrorAngles]) -> None:
        """Uploads positions (at most `max_sequence`) for stepping by trigger edges, with marker outputs if wired."""
        ...

    def start(self) -> None:
        """Arms the loaded sequence: each trigger edge steps to the next position."""
        ...

    def stop(self) -> None:
        """Ends stepping; the mirror stays where it is."""
        ...

    def look(self) -> None:
        """Raises `DeviceLost` where the cable is gone and `DeviceReset` where the controller restarted. Sends nothing
        and waits for nothing: called every 10 ms while the light is on."""
        ...

    def park(self) -> None:
        """Centre, or the beam dump where the bench names one. Called after the shutter is closed."""
        ...

    def close(self) -> None:
        """Releases the port. May be called twice, and after any error."""
        ...


@runtime_checkable
class MeasuresPosition(Protocol):
    """A mirror whose controller has a sensor of its own."""

    def measured(self) -> MirrorAngles:
        """Where it sees the mirror now. Raises `DeviceFault` where that is far from where it was sent."""
        ...


@runtime_checkable
class VerifiedByEye(Protocol):
    """A mirror whose controller may confirm moves that it does not make; only a person sees the difference."""

    @property
    def shows_that_it_moves(self) -> bool:
        """Whether nobody needs to look."""
        ...

    def check_trusted(self) -> None:
        """Raises `DeviceFault` where it may not be moved without having been seen to move."""
        ...

    def trusted_for_trial(self) -> AbstractContextManager[None]:
        """While the block runs it may be moved, for somebody who looks."""
        ...

    def trust(self) -> None:
        """A person saw it move."""
        ...
