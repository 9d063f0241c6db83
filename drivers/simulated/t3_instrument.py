"""The inside of a counter in T3 mode: photons, wraps and marker edges become records as bench time passes.

Light between two clock edges is drawn for the whole period from where the beam comes to rest, and replaced by that of
the moving beam until then. It is drawn backwards from the period's end, where the dwell is: what a dwell holds depends
on its place and length alone, not on where the beam came from, nor on how long it was given to come.
"""

from collections import deque
from collections.abc import Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from nlos.drivers.simulated import spad
from nlos.drivers.simulated.bench import Gate, SimulatedBench
from nlos.drivers.simulated.sync_input import SyncInput
from nlos.drivers.tcspc.t3 import T3Format

_NEVER_S = float("inf")
_CLOCK_UNIT_S = 100e-9
_STRETCHED_S = 20e-6  # the outputs are NIM pulses: a stretcher makes TTL pulses of them that a polled input sees
_SLICE_S = 500e-6
"""While the mirror moves, light is taken from where the beam is in the middle of each such slice."""
_INSTANT_S = 0.5e-6
_SAME_EDGE_S = 1e-9
_STEP_MARKERS = 0b011
_MOVING = 1 << 16
"""Pieces of light from a moving beam are numbered from here, apart from those of the beam at rest."""
_LAYER_S = 1e-3
_FIFO_RECORDS = 2_000_000
_SALT = 3


class T3Instrument:
    """Trigger output, marker inputs 1 to 3, and a FIFO."""

    def __init__(
        self,
        bench: SimulatedBench,
        layout: T3Format,
        repetition_hz: float,
        seed: int,
        sync: SyncInput | None = None,
    ) -> None:
        self._sync = sync or SyncInput(repetition_hz)
        self._bench, self._layout, self._repetition_hz, self._seed = bench, layout, repetition_hz, seed
        self._fifo: deque[npt.NDArray[np.uint32]] = deque()
        self._waiting = 0
        self._markers: list[tuple[int, int]] = []
        self._period_s = 0.0
        self._edge_s = self._end_s = _NEVER_S
        self._started_s = self._done_s = self._bin_width_s = 0.0
        self._wraps = 0
        self._running = False
        self._stepped = self._left_alone = False  # by marks that are not of this clock; and no more of them will come
        self._number: int | None = None  # of the point under way
        self._marked_s = -_NEVER_S
        self.overrun = False
        self.hears = True
        """Whether the detector's pulses cross the trigger level."""
        bench.follow(self.advance)
        for k, line in enumerate(("marker_1", "marker_2", "marker_4")):
            bench.wire(line, partial(self._mark, 1 << k))
        bench.wire("last_step_over", self._let_alone)

    def start(self, now_s: float, ends_s: float, bin_width_s: float) -> None:
        self._fifo.clear()
        self._markers.clear()
        self._waiting = self._wraps = 0
        self._started_s = self._done_s = now_s
        self._end_s, self._bin_width_s = ends_s, bin_width_s
        self._running, self.overrun = True, False
        self._stepped = self._left_alone = False
        self._number, self._marked_s = None, -_NEVER_S

    def stop(self) -> None:
        """Ends the measurement; without a clock, what it saw so far is recorded."""
        if self._running and self._edge_s == _NEVER_S:
            self._expose_until(self._bench.clock.now())
        self._running = False

    def set_clock(self, period_100ns: int, now_s: float) -> None:
        """The trigger output ticks at once, then every period; 0 turns it off."""
        self._period_s = period_100ns * _CLOCK_UNIT_S
        self._edge_s = now_s if period_100ns else _NEVER_S

    def advance(self, now_s: float) -> None:
        """Everything until `now_s`: clock edges, the markers that they cause, and light in between."""
        self._bench.let_pass(now_s)
        running, self._running = self._running, False  # an edge moves the bench, which asks whether we are up to date
        while self._edge_s <= now_s:
            if running:
                self._expose_until(self._edge_s)
                self._number = self._bench.turns.next_number()
            edge_s, self._edge_s = self._edge_s, self._edge_s + self._period_s
            self._bench.edge("pixel_clock", edge_s, _STRETCHED_S)
        if running and self._edge_s == _NEVER_S and now_s >= self._end_s - 1e-9:
            self._expose_until(self._end_s)
        elif running and self._left_alone:
            self._expose_until(now_s)
        self._running = running

    def read(self, most: int) -> npt.NDArray[np.uint32]:
        """Takes up to `most` records from the FIFO."""
        taken: list[npt.NDArray[np.uint32]] = []
        while self._fifo and most > 0:
            piece = self._fifo.popleft()
            if len(piece) > most:
                self._fifo.appendleft(piece[most:])
                piece = piece[:most]
            taken.append(piece)
            most -= len(piece)
            self._waiting -= len(piece)
        return np.concatenate(taken) if taken else np.zeros(0, dtype=np.uint32)

    @property
    def told_s(self) -> float:
        """Until when it has recorded what there was."""
        return self._done_s

    def _mark(self, bit: int, when_s: float) -> None:
        if self._running and self._edge_s == _NEVER_S:
            self._stepped = True
            self._left_alone = False
            self._expose_until(when_s)
            if when_s - self._marked_s > _SAME_EDGE_S and bit & _STEP_MARKERS:
                self._number, self._marked_s = self._bench.turns.next_number(), when_s
        self._markers.append((self._pulse(when_s), bit))

    def _let_alone(self, when_s: float) -> None:
        if self._running and self._stepped:
            self._expose_until(when_s)
            self._left_alone = True

    def _expose_until(self, until_s: float) -> None:
        """Records of the time since the last call: one clock period, or one measurement."""
        start_s, until_s = self._done_s, min(until_s, self._end_s)
        if until_s - start_s < _SAME_EDGE_S:
            return
        if self._edge_s == _NEVER_S and not self._stepped:
            self._number = self._bench.turns.next_number()
        at_rest, settled_s = self._bench.beam_at(until_s), start_s
        pulses: list[npt.NDArray[np.int64]] = []
        delays: list[npt.NDArray[np.int64]] = []
        if self._bench.beam_at(until_s - _INSTANT_S) != at_rest:  # on a continuous line it does not come to rest
            moving, delays_moving = self._photons(start_s, until_s - start_s)
            self._record(moving + self._pulse(start_s), delays_moving, self._pulse(until_s))
            self._done_s = until_s
            return
        while self._bench.beam_at(settled_s) != at_rest:
            slice_s = self._moves_s(settled_s, min(_SLICE_S, until_s - settled_s))
            moving, delays_moving = self._photons(settled_s, slice_s, _MOVING + len(pulses), kept=False)
            pulses.append(moving + self._pulse(settled_s))
            delays.append(delays_moving)
            settled_s += slice_s
        self._number = self._bench.turns.number_at(at_rest)
        for resting, delays_resting in self._resting(settled_s, start_s, until_s):
            settled = resting >= self._pulse(settled_s)
            pulses.append(resting[settled])
            delays.append(delays_resting[settled])
        self._record(np.concatenate(pulses), np.concatenate(delays), self._pulse(until_s))
        self._done_s = until_s

    def _moves_s(self, since_s: float, most_s: float) -> float:
        """How much of the time after `since_s` the beam is still moving, or rests where another step will find it."""
        at_rest = self._bench.beam_at(since_s + most_s)
        if self._bench.beam_at(since_s) == at_rest or self._bench.beam_at(since_s + most_s + _INSTANT_S) != at_rest:
            return most_s
        least_s = 0.0
        while most_s - least_s > _INSTANT_S:
            middle_s = (least_s + most_s) / 2
            if self._bench.beam_at(since_s + middle_s) == at_rest:
                most_s = middle_s
            else:
                least_s = middle_s
        return most_s

    def _resting(
        self, settled_s: float, start_s: float, until_s: float
    ) -> Iterator[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]]:
        """Laser pulse (since the measurement's start) and delay of the photons from where the beam rests, in layers
        from the end of the period; the measurement of a single point is one piece."""
        if self._edge_s == _NEVER_S and not self._stepped:
            pulses, delays = self._photons(settled_s, until_s - start_s)
            yield pulses + self._pulse(start_s), delays
            return
        end, near_s, far_s, layer = self._pulse(until_s), 0.0, _LAYER_S, 0
        while near_s < until_s - settled_s:
            back, delays = self._photons(settled_s, far_s - near_s, layer)
            yield end - 1 - round(near_s * self._repetition_hz) - back, delays
            near_s, far_s, layer = far_s, 4 * far_s, layer + 1

    def _photons(
        self, when_s: float, dwell_s: float, piece: int = 0, kept: bool = True
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Laser pulse (counted from 0) and delay of the photons from where the beam points at `when_s`, or, while it
        moves (not `kept`), in the middle of the dwell."""
        bins = min(1 << self._layout.delay_bits, int(1 / (self._repetition_hz * self._bin_width_s)) + 1)
        opened_s = when_s if kept else when_s + dwell_s / 2
        beam = self._bench.beam_at(opened_s)
        gate = self._bench.told_apart(
            Gate(opened_s, dwell_s, bins, self._bin_width_s, 0.0, self._number, kept=kept, piece=piece), beam
        )
        rng = spad.generator(self._seed, gate, beam, _SALT)
        pulses, delays = spad.arrivals(self._bench.expose(gate), rng)
        return (pulses, delays) if self.hears else (pulses[:0], delays[:0])

    def _pulse(self, when_s: float) -> int:
        return round((when_s - self._started_s) * self._repetition_hz)

    def _record(self, pulses: npt.NDArray[np.int64], delays: npt.NDArray[np.int64], last: int) -> None:
        pulses, delays = self._sync.timed(pulses, delays, self._bin_width_s)
        told = delays < 1 << self._layout.delay_bits
        pulses, delays, last = pulses[told], delays[told], last // self._sync.every
        wrap = self._layout.wrap
        markers = np.array(self._markers, dtype=np.int64).reshape(-1, 2)
        markers[:, 0] //= self._sync.every
        self._markers.clear()
        wraps = np.arange(self._wraps + 1, last // wrap + 1, dtype=np.int64) * wrap
        self._wraps = max(self._wraps, last // wrap)
        late = 0
        if (fault := self._bench.faults.strikes("U20", self._done_s, "marker")) is not None:
            late = int(fault.parameters.get("late_pulses", 100))
        # Late within its wrap: behind the next overflow record it would mean another time.
        place = np.minimum(markers[:, 0] + late, markers[:, 0] | (wrap - 1))
        at = np.concatenate((wraps, place, pulses))
        records = np.concatenate(
            (
                np.full(len(wraps), self._overflow(), dtype=np.uint32),
                self._marker_records(markers),
                self._photon_records(pulses, delays),
            )
        )
        kinds = np.repeat((0, 1, 2), (len(wraps), len(markers), len(pulses)))
        self._push(records[np.lexsort((kinds, at))])

    def _push(self, records: npt.NDArray[np.uint32]) -> None:
        if self._waiting + len(records) > _FIFO_RECORDS:
            self.overrun = True
        if not self.overrun:
            self._fifo.append(records)
            self._waiting += len(records)

    def _overflow(self) -> int:
        return 15 << 28 if self._layout.first_channel else 1 << 31 | 63 << 25 | 1

    def _marker_records(self, markers: npt.NDArray[np.int64]) -> npt.NDArray[np.uint32]:
        pulse, bits = markers[:, 0] & (self._layout.wrap - 1), markers[:, 1]
        if self._layout.first_channel:
            return (15 << 28 | bits << 16 | pulse).astype(np.uint32)
        return (1 << 31 | bits << 25 | pulse).astype(np.uint32)

    def _photon_records(self, pulses: npt.NDArray[np.int64], delays: npt.NDArray[np.int64]) -> npt.NDArray[np.uint32]:
        layout = self._layout
        channel = layout.first_channel << (layout.pulse_bits + layout.delay_bits)
        return (channel | delays << layout.pulse_bits | pulses & (layout.wrap - 1)).astype(np.uint32)
