"""The one beam, clock and shutter that all simulated instruments share."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.clock import VirtualClock
from drivers.galvo.mirror import MirrorAngles
from drivers.simulated.faults import FaultPlan


@dataclass(frozen=True)
class Gate:
    """What a counter asks of the light: when it listens, for how long, and on which time axis.

    `number` is the plan's point number where the host stamped one: photons are drawn from (seed, number), so that a
    point taken again holds the same counts. Without it they are drawn from (seed, beam position, dwell).
    """

    opened_s: float
    dwell_s: float
    bins: int
    bin_width_s: float
    offset_s: float
    number: int | None = None
    stop_counts: int = 0
    stop_window: tuple[int, int] | None = None


@dataclass(frozen=True)
class Exposure:
    """What the detector gave in one gate."""

    counts: npt.NDArray[np.uint32]  # (T,)
    live_s: float
    sync_count: int
    total_count: int
    stopped_early: bool


Light = Callable[[Gate, MirrorAngles, bool], Exposure]
"""(gate, where the beam points, whether the shutter is open) -> what the detector saw."""


class SimulatedBench:
    """Where the beam points, whether the shutter is open, which wires carry edges, and what the detector sees."""

    def __init__(self, light: Light, clock: VirtualClock | None = None, faults: FaultPlan | None = None) -> None:
        self.clock = clock or VirtualClock()
        self.faults = faults or FaultPlan()
        self.interlock_closed = True
        self.shutter_open = False
        self._light = light
        self._beam = MirrorAngles(0.0, 0.0)
        self._wires: dict[str, list[Callable[[float], None]]] = {}

    def steer(self, angles: MirrorAngles) -> None:
        """A mirror controller's output changed: the beam points there from now on."""
        self._beam = angles

    @property
    def beam(self) -> MirrorAngles:
        return self._beam

    def set_shutter(self, is_open: bool) -> None:
        """The shutter's drive line changed. An open interlock loop keeps it closed."""
        self.shutter_open = is_open and self.interlock_closed

    def wire(self, line: str, listener: Callable[[float], None]) -> None:
        """Connects an instrument's input to a named line (`pixel_clock`, `marker_1`, ...)."""
        self._wires.setdefault(line, []).append(listener)

    def edge(self, line: str, when_s: float) -> None:
        """A rising edge on a line at bench time `when_s`, in the order of calls."""
        for listener in self._wires.get(line, []):
            listener(when_s)

    def expose(self, gate: Gate) -> Exposure:
        """What the detector counts in `gate` with beam and shutter as they are now."""
        return self._light(gate, self._beam, self.shutter_open)
