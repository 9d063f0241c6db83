"""What every photon counter does: histogram arrival times, point by point, and say what it lost."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, IntFlag
from typing import Protocol

import numpy as np
import numpy.typing as npt

from nlos.drivers.errors import LimitError
from nlos.drivers.identity import DeviceIdentity

WAITING_NUMBER = 0xFFFF_FFFF
"""Counting down from here, the numbers of points at which the counter only waits for the mirror."""
WAITING_NUMBERS = range(WAITING_NUMBER - 0xFFFF, WAITING_NUMBER + 1)


class HistogramFlag(IntFlag):
    """What went wrong while a histogram was taken. The numbers are those of the `tcspc488` record."""

    NONE = 0
    SATURATED = 1
    STOPPED_EARLY = 2
    SYNC_LOST = 4
    OVER_RATE = 8
    OVERRUN = 16
    TRIGGER_LATE = 32
    TRIGGER_MISSED = 64
    DATA_LOST = 128


@dataclass(frozen=True)
class Histogram:
    """Counts of one point. `live_time_s`: how long photons were really accepted; rates divide by it, never by dwell."""

    counts: npt.NDArray[np.uint32]  # (T,)
    bin_width_s: float
    offset_s: float
    live_time_s: float
    sync_count: int
    total_count: int
    flags: HistogramFlag
    gate_opened_s: float
    """Instrument time at which the gate opened, seconds since the instrument was armed."""


@dataclass(frozen=True)
class HistogramAxis:
    """The time axis asked for: `bins` of `bin_width_s`, the first one starting `offset_s` after the sync pulse."""

    bins: int
    bin_width_s: float
    offset_s: float = 0.0


@dataclass(frozen=True)
class StopAtCounts:
    """Ends a point before its dwell is over, once `counts` photons fell into bins `first_bin` up to, not including,
    `end_bin`. The record then carries `STOPPED_EARLY` and the live time at which the last of them came."""

    counts: int
    first_bin: int
    end_bin: int


@dataclass(frozen=True)
class CountRates:
    """Sync and detector rates in 1/s, measured over the instrument's own window."""

    sync_hz: float
    detector_hz: float


class Trigger(Enum):
    """What starts each armed point."""

    HOST = "host"
    """`trigger()`, one point at a time (scheme S1)."""

    CLOCK = "clock"
    """The counter's own pixel clock, which also steps the mirror (scheme S2)."""

    MIRROR = "mirror"
    """The marks of a mirror that steps by a clock of its own."""


@dataclass(frozen=True)
class PointGates:
    """Points to get ready for. `numbers` are the plan's own, stamped into the records so that a record can never be
    taken for another point's. `blanking_s`: dead time after each clock step while the mirror settles. `step_s`: with
    `Trigger.MIRROR`, how often the mirror steps."""

    dwells_s: Sequence[float]
    numbers: Sequence[int]
    trigger: Trigger = Trigger.HOST
    blanking_s: float = 0.0
    step_s: float = 0.0

    def check(self, device: str, axis: HistogramAxis | None, most: int) -> HistogramAxis:
        """The axis. Raises `LimitError` where none was set, and for more points than `most`, or none."""
        if axis is None:
            raise LimitError(device, "armed before a time axis was set.", "Call configure() first.")
        dwells, numbers = len(self.dwells_s), len(self.numbers)
        if dwells != numbers or not 1 <= dwells <= most:
            raise LimitError(device, f"{dwells} dwells and {numbers} numbers.", f"Arm as many of both, 1 to {most}.")
        return axis


@dataclass(frozen=True)
class CounterStatus:
    """`points_done` counts complete points since `arm`; `markers` the mirror's marker edges, None where not wired;
    `steps_due` how many there should have been by then. Where the two differ, mirror and counter are out of step."""

    running: bool
    points_done: int
    lost: int
    markers: int | None
    steps_due: int = 0


class HistogramCounter(Protocol):
    """A counter that takes armed points one after the other and keeps each until it is read.

    Settings that the hardware cannot represent exactly raise `LimitError`; nothing is rounded.
    """

    @property
    def identity(self) -> DeviceIdentity:
        """Who it said it is when it was opened."""
        ...

    @property
    def max_points(self) -> int:
        """How many points one `arm` takes."""
        ...

    @property
    def has_pixel_clock(self) -> bool:
        """Whether a clock of its own can step a mirror (`Trigger.CLOCK`)."""
        ...

    @property
    def follows_mirror(self) -> bool:
        """Whether it is wired so that the marks of a mirror with a clock of its own begin its points."""
        ...

    @property
    def list_mode(self) -> bool:
        """Whether histograms are sorted out of a stream of photons by the mirror's markers (scheme S3). Its clock has
        one period: points that it steps need equal dwells."""
        ...

    @property
    def counts_markers(self) -> bool:
        """Whether the mirror controller's marker outputs are wired to it, so that steps can be counted."""
        ...

    @property
    def has_watchdog(self) -> bool:
        """Whether the instrument closes the shutter by itself when the host stops kicking."""
        ...

    def check(self, axis: HistogramAxis, dwell_s: float, stop: StopAtCounts | None = None) -> None:
        """Raises `LimitError` where axis, dwell or stop cannot be set exactly. Sends nothing."""
        ...

    def nearest_axis(self, axis: HistogramAxis) -> HistogramAxis:
        """`axis` where it can be set exactly, else its window on the nearest bin width that the counter has. Raises
        `LimitError` naming the widths where none is near. Sends nothing."""
        ...

    def configure(self, axis: HistogramAxis, stop: StopAtCounts | None = None) -> None:
        """Sets the time axis and, for exposures that end at a number of counts, when to stop early."""
        ...

    def arm(self, gates: PointGates) -> None:
        """Gets ready for these points. Raises `LimitError` for what the instrument cannot do exactly."""
        ...

    def trigger(self) -> None:
        """Opens the gate for the next armed point (`Trigger.HOST`)."""
        ...

    def wait_points(self, count: int, timeout_s: float) -> CounterStatus:
        """Returns when `count` points since `arm` are complete, kicking the watchdog meanwhile. Raises
        `DeviceTimeout`, and `SafetyTrip` as soon as the instrument reports one."""
        ...

    def rest(self, seconds: float) -> bool:
        """Sits through that much of an open gate, kicking the watchdog meanwhile. False as soon as all triggered
        points are complete. Raises `SafetyTrip` as soon as the instrument reports one."""
        ...

    def meanwhile(self, look: Callable[[], None]) -> None:
        """From now on `look` is called every 10 ms while points are waited for. What it raises ends the wait."""
        ...

    def read(self, first: int, count: int) -> list[Histogram]:
        """The histograms of points `first`.. since `arm`, which must be complete. May be repeated."""
        ...

    def abort(self) -> None:
        """Closes the gate and forgets what was armed."""
        ...

    def rates(self) -> CountRates:
        """What its inputs count now. Raises `DeviceError`."""
        ...

    def arm_watchdog(self, timeout_s: float) -> None:
        """The instrument closes the shutter unless kicked within `timeout_s`; 0 turns it off."""
        ...

    def kick(self) -> None:
        """Tells the watchdog that the host is alive."""
        ...

    def clear_trip(self) -> None:
        """Forgets a latched trip. Called where a person says so, never by itself."""
        ...

    def close(self) -> None:
        """Releases the instrument. May be called twice, and after any error."""
        ...
