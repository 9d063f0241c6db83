"""The one beam, clock and shutter that all simulated instruments share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from nlos.drivers.clock import VirtualClock
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.faults import FaultPlan
from nlos.drivers.simulated.servo import ServoSettings
from nlos.drivers.simulated.swing import Swing
from nlos.drivers.simulated.turns import Turns
from nlos.drivers.tcspc.counter import WAITING_NUMBERS, HistogramAxis


@dataclass(frozen=True)
class Gate:
    """What a counter asks of the light: when it listens, for how long, and on which time axis.

    `number` is the plan's point number where the host stamped or announced one: photons are drawn from (seed, number,
    piece), so that a point taken again holds the same counts. Without it they are drawn from (seed, beam position,
    dwell, turn).
    """

    opened_s: float
    dwell_s: float
    bins: int
    bin_width_s: float
    offset_s: float
    number: int | None = None
    stop_counts: int = 0
    stop_window: tuple[int, int] | None = None
    kept: bool = True
    """False for a look at the rate meter and for photons of a beam in flight: no measurement holds them."""
    track: tuple[MirrorAngles, ...] = ()
    """Where a beam that never rests is while the gate is open, evenly in time; empty where it rests."""
    since_lit_s: float = 0.0
    """When it opens, in seconds since the first point of a measurement was lit on this bench: a scene's own time."""
    piece: int = 0
    """Which part of a point's light this is, where an instrument draws it in parts."""
    turn: int | None = None
    """How many gates of this place and length there were before it; None: not counted yet."""


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


@runtime_checkable
class LimitedLight(Protocol):
    """A `Light` that does not shine everywhere, nor indefinitely."""

    def is_hole(self, beam: MirrorAngles) -> bool:
        """Whether it lacks just this place."""
        ...

    def check(self, gate: Gate, beam: MirrorAngles) -> None:
        """Raises `LimitError` where it cannot give what is asked."""
        ...


@runtime_checkable
class LightOnAWall(Protocol):
    """A `Light` that knows where on a wall its beam lands."""

    def spot_m(self, beam: MirrorAngles) -> tuple[float, float] | None:
        """(x, y), or None where it does not meet the wall."""
        ...


Pulse = Callable[[float, float], None]
"""(bench time of the rising edge, seconds until the falling one)"""

_PLACES = 3
"""At how many places along the way of a moving beam its light is taken."""


class SimulatedBench:
    """Where the beam points, whether the shutter is open, which wires carry edges, and what the detector sees."""

    def __init__(
        self,
        light: Light,
        clock: VirtualClock | None = None,
        faults: FaultPlan | None = None,
        servo: ServoSettings | None = None,
        shutterless: bool = False,
    ) -> None:
        """`shutterless`: nothing blocks the laser, whatever any drive line does."""
        self.clock = clock or VirtualClock()
        self.faults = faults or FaultPlan()
        self.servo = servo or ServoSettings()
        self.interlock_closed = True
        self.on_gate: Callable[[Gate, MirrorAngles], None] | None = None
        """A witness: told of every gate of a measurement and of the mean place of the beam while it is open."""
        self._shutterless = self._shutter_open = shutterless
        self.light = light
        """What the detector sees; a test may change it in the middle of a scan."""
        self._x = Swing(0.0, 0.0, 0.0, 0.0)
        self._y = Swing(0.0, 0.0, 0.0, 0.0)
        self._path: Callable[[float], MirrorAngles] = self._swing
        self._wires: dict[str, list[tuple[float, Pulse]]] = {}
        self._going_on: list[Callable[[float], None]] = []
        self._clocks: list[Callable[[float], None]] = []
        self._passing = False
        self._lit_s: float | None = None
        self.turns = Turns()
        self.witness: Callable[[float, str], None] = lambda when_s, what: None
        """Told of every change of shutter and beam as it happens on this bench, whoever caused it."""

    def spot_m(self, beam: MirrorAngles) -> tuple[float, float] | None:
        """Where a ruler on the wall finds the spot of this beam, (x, y); None where the light knows no wall."""
        light: object = self.light
        return light.spot_m(beam) if isinstance(light, LightOnAWall) else None

    def holes(self, beams: Sequence[MirrorAngles]) -> list[int]:
        """Which of these places a recorded scene lacks, though it was to be measured there."""
        light: object = self.light
        return [k for k, beam in enumerate(beams) if light.is_hole(beam)] if isinstance(light, LimitedLight) else []

    def check(self, beams: Sequence[MirrorAngles], axis: HistogramAxis, dwells_s: Sequence[float]) -> None:
        """Raises `LimitError` where a recorded scene does not hold what is asked of it. Nothing moves."""
        light: object = self.light
        if isinstance(light, LimitedLight):
            for number, (beam, dwell_s) in enumerate(zip(beams, dwells_s, strict=True)):
                light.check(Gate(0.0, dwell_s, axis.bins, axis.bin_width_s, axis.offset_s, number), beam)

    def steer(self, angles: MirrorAngles, when_s: float | None = None, settle_s: float = 0.0) -> None:
        """A mirror controller's output changed at `when_s` (now): the beam points there `settle_s` later, until
        then somewhere on its way."""
        start_s = self.clock.now() if when_s is None else when_s
        self.witness(start_s, f"beam to {angles.x_rad:.6f} {angles.y_rad:.6f}")
        self._x = self._x.towards(angles.x_rad, start_s, settle_s)
        self._y = self._y.towards(angles.y_rad, start_s, settle_s)
        self._path = self._swing

    def follow_path(self, path: Callable[[float], MirrorAngles], angles: MirrorAngles, when_s: float) -> None:
        """The beam is sent to `angles` at `when_s`, and is where `path` says at every time from then on."""
        self.witness(when_s, f"beam to {angles.x_rad:.6f} {angles.y_rad:.6f}")
        self._path = path

    @property
    def beam(self) -> MirrorAngles:
        """Where the beam points now."""
        return self.beam_at(self.clock.now())

    def beam_at(self, when_s: float) -> MirrorAngles:
        """Where the beam points at a bench time not before the last steering."""
        self.let_pass(when_s)
        return self._path(when_s)

    def _swing(self, when_s: float) -> MirrorAngles:
        return MirrorAngles(self._x.at(when_s), self._y.at(when_s))

    @property
    def shutter_open(self) -> bool:
        """Whether light passes now, whatever instruments have done by themselves in the meantime."""
        self._catch_up()
        return self._shutter_open

    def set_shutter(self, is_open: bool) -> None:
        """The shutter's drive line changed. An open interlock loop keeps it closed."""
        if self._shutterless:
            return
        self._catch_up()
        self._shutter_open = is_open and self.interlock_closed
        self.witness(self.clock.now(), f"shutter {'open' if self._shutter_open else 'closed'}")

    def follow(self, catch_up: Callable[[float], None]) -> None:
        """An instrument that runs by itself: `catch_up(now)` is called before the shutter changes, so that what was
        due until then sees the light as it was."""
        self._going_on.append(catch_up)

    def ticks(self, until: Callable[[float], None]) -> None:
        """An instrument with a clock of its own, whose edges others follow: told by `let_pass` to come up to now."""
        self._clocks.append(until)

    def let_pass(self, now_s: float) -> None:
        """What clocks other than the asker's own do until then. Called by an instrument before it looks at itself."""
        if self._passing:
            return  # an edge is being answered: whoever answers may look ahead, time does not go there
        self._passing = True
        try:
            for until in self._clocks:
                until(now_s)
        finally:
            self._passing = False

    def _catch_up(self) -> None:
        for catch_up in self._going_on:
            catch_up(self.clock.now())

    def wire(self, line: str, listener: Callable[[float], None]) -> None:
        """Connects an instrument's input to a named line (`pixel_clock`, `marker_1`, ...): told of rising edges."""
        self.wire_pulses(line, lambda when_s, width_s: listener(when_s))

    def wire_pulses(self, line: str, listener: Pulse, least_s: float = 0.0) -> None:
        """An input that is told how long the line stays high, and does not see less than `least_s`."""
        self._wires.setdefault(line, []).append((least_s, listener))

    def edge(self, line: str, when_s: float, width_s: float = 100e-6) -> None:
        """A rising edge on a line at bench time `when_s`, in the order of calls; `width_s` later it is low again."""
        for least_s, listener in self._wires.get(line, []):
            if width_s >= least_s:
                listener(when_s, width_s)

    def expose(self, gate: Gate) -> Exposure:
        """What the detector counts in `gate`: shutter as it is now, beam where it is, or on its way, until then."""
        beam = self.beam_at(gate.opened_s)
        if self._lit_s is None and gate.kept and self._shutter_open and gate.number not in WAITING_NUMBERS:
            self._lit_s = gate.opened_s
        if self._lit_s is not None:
            gate = replace(gate, since_lit_s=gate.opened_s - self._lit_s)
        if gate.kept:
            gate, beam = self._along_the_way(gate, beam)
            if self.on_gate is not None:
                self.on_gate(gate, beam)
        return self.light(self.told_apart(gate, beam), beam, self._shutter_open)

    def first_lit(self, when_s: float) -> None:
        """When the scene's own time began, in bench time, before this bench was opened."""
        self._lit_s = when_s

    def told_apart(self, gate: Gate, beam: MirrorAngles) -> Gate:
        """A gate without a number, and its turn among those like it."""
        known = gate.number is not None or gate.turn is not None
        return gate if known else replace(gate, turn=self.turns.turn(beam, gate.dwell_s))

    def look(self, beam: MirrorAngles, axis: HistogramAxis, dwell_s: float, number: int) -> npt.NDArray[np.uint32]:
        """What would be counted at a point of a plan, (T,), if the beam were there and the shutter open. No instrument
        takes part, nothing moves."""
        gate = Gate(self.clock.now(), dwell_s, axis.bins, axis.bin_width_s, axis.offset_s, number)
        return self.light(gate, beam, True).counts

    def _along_the_way(self, gate: Gate, beam: MirrorAngles) -> tuple[Gate, MirrorAngles]:
        """The gate with the track of a beam that does not rest in it, and the mean place of the beam."""
        moments = ((k + 0.5) / _PLACES for k in range(_PLACES))
        track = tuple(self.beam_at(gate.opened_s + part * gate.dwell_s) for part in moments)
        if all(each == beam for each in track):
            return gate, beam
        mean = MirrorAngles(sum(each.x_rad for each in track) / _PLACES, sum(each.y_rad for each in track) / _PLACES)
        return replace(gate, track=track), mean
