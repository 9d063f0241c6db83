"""What every mirror controller does: aim the beam, within limits that are checked before anything is sent."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from nlos.drivers.errors import LimitError
from nlos.drivers.identity import DeviceIdentity


@dataclass(frozen=True)
class MirrorAngles:
    """Optical deflection (twice the mechanical) in radians, +x right and +y up as seen by the scanner."""

    x_rad: float
    y_rad: float


def axes_rad(angles: Sequence[MirrorAngles]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Their x_rad and y_rad, (N,) each."""
    return np.array([each.x_rad for each in angles]), np.array([each.y_rad for each in angles])


class GalvoMirror(Protocol):
    """A two-axis mirror. Positions outside the limits raise `LimitError`; nothing is ever clipped.

    After any error during a move the axis state is unknown: further moves raise until `close()`, or, after a
    `MirrorDisturbed`, until `park()`.
    """

    @property
    def identity(self) -> DeviceIdentity:
        """Who it said it is when it was opened."""
        ...

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
class ManyAtOnce(Protocol):
    """A mirror that answers for a whole plan at once what `check` and `settle_s` answer for a place: plans have up to
    millions. Others are asked place by place."""

    def reaches_all(self, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> bool:
        """Whether it is certain that `check` refuses none of these, (N,); where it is not, each is to be asked."""
        ...

    def settles_s(self, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """`settle_s` from each of these, (N,), to the next, (N - 1,): the same to the last digit."""
        ...


@runtime_checkable
class LooksAgain(Protocol):
    """A mirror that compares some of its places with what its own sensor sees. Others cannot."""

    def looks_s(self, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """How long it takes for that at each of these places, taken in turn from now on, beside settling, (N,)."""
        ...


@runtime_checkable
class KeepsSettings(Protocol):
    """A mirror whose controller holds settings that a power cut takes, by which its positions mean other angles then,
    and that may say nothing of it. Others move as they are told whatever was before, or say that they cannot."""

    def restore(self) -> None:
        """Sends all of them again and centres; a restart that the controller tells of is among `warnings` then. In the
        dark only: the beam may swing anywhere meanwhile."""
        ...


def surely_reached(mirror: GalvoMirror, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> bool:
    """Whether the mirror says at once that it reaches all of these; else ask for each by `check`."""
    return isinstance(mirror, ManyAtOnce) and len(x_rad) > 0 and mirror.reaches_all(x_rad, y_rad)


def reaches_corners(
    check: Callable[[MirrorAngles], None], x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]
) -> bool:
    """Whether `check` refuses no corner of the rectangle of angles around these, (N,), N > 0: of heads whose limits
    grow with the angle of either axis, nothing within it is refused then."""
    try:
        for x in (x_rad.min(), x_rad.max()):
            for y in (y_rad.min(), y_rad.max()):
                check(MirrorAngles(float(x), float(y)))
    except LimitError:
        return False
    return True


@dataclass(frozen=True)
class OwnSteps:
    """What a mirror's own clock makes of points of one dwell."""

    dwell_s: float
    settling_s: float
    """What was asked for: how long each point lasts, and how long the mirror needs before it."""
    step_s: float
    """From the mark of one step to that of the next."""
    blanking_s: float
    """From a mark to the dwell behind it, in whole microseconds: at least `settling_s`. What is left of the step after
    the dwell is spare, because no two clocks are the same."""
    first_s: float
    """From `play` to the first mark."""


@runtime_checkable
class OwnClock(Protocol):
    """A mirror that plays a sequence on a clock of its own, which no edge starts or steps, and marks every step: on
    lines 1 and 2 in turn, on line 3 with the first, and on a fourth for counters that want one edge per point."""

    @property
    def has_own_clock(self) -> bool:
        """Whether the bench file says that its marks are wired."""
        ...

    def most_steps(self, dwell_s: float) -> int:
        """How many positions of that dwell one sequence holds."""
        ...

    def own_steps(self, dwell_s: float, settling_s: float) -> OwnSteps:
        """The shortest steps of its clock that hold both. Raises `LimitError` where it has none."""
        ...

    def load_steps(self, sequence: Sequence[MirrorAngles], steps: OwnSteps) -> None:
        """Gets the sequence ready at the pace that `own_steps` made; `start` then goes to its first position,
        `stop` ends it. Raises `LimitError`."""
        ...

    def play(self) -> None:
        """Plays it once, from now on."""
        ...


def own_clock(mirror: GalvoMirror) -> OwnClock | None:
    """The mirror, if it steps by a clock of its own and the bench file says that its marks are wired."""
    return mirror if isinstance(mirror, OwnClock) and mirror.has_own_clock else None


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
