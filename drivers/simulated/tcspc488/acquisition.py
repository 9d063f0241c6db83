"""What happens inside a simulated `tcspc488` as bench time passes: gates, slots, pixel clock, trips and watchdog.

Nothing runs by itself: whoever asks brings the time along, and everything due until then happens in the order of its
own times. A gate's photons are drawn as it opens.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench
from nlos.drivers.simulated.faults import one_of
from nlos.drivers.simulated.tcspc488.protection import INTERLOCK, NEVER_S, SYNC, Protection
from nlos.drivers.simulated.tcspc488.time_tags import TimeTags
from nlos.drivers.tcspc.counter import HistogramFlag

RATE_WINDOW_S = 0.1
SLOTS = 4096
MAX_POINTS = 65536
_SLACK_S = 1e-9
_FLAGS = {"missed": 64, "late": 32, "overrun": 16}


@dataclass
class AcquisitionSettings:
    """What the `HIST`, `ACQ`, `OUTP` and `PROT` commands set; the values are those after `*RST`."""

    bin_width_ps: int = 32
    bins: int = 512
    offset_ps: int = 0
    wide: bool = True
    mode: str = "HIST"
    points: int = 1
    dwells_us: list[int] = field(default_factory=lambda: [1000])
    numbers: list[int] = field(default_factory=list)
    blanking_us: int = 0
    stop_counts: int = 0
    stop_window: tuple[int, int] | None = None
    source: str = "IMM"
    trigger_timeout_ms: int = 0
    clock_100ns: int = 0
    trip_rate_hz: int = 0
    trip_time_ms: int = 10


@dataclass
class Slot:
    """One complete point."""

    index: int
    number: int
    gate: Gate
    exposure: Exposure
    flags: int


@dataclass
class _OpenGate:
    slot: Slot
    closes_s: float


class Acquisition:
    """The state machine IDLE, ARMED, RUN, DONE, TRIP, FAULT and what it keeps."""

    def __init__(self, bench: SimulatedBench, report: Callable[[int], None], signal: Callable[[], None]) -> None:
        self._bench = bench
        self._report = report
        self._signal = signal
        self.settings = AcquisitionSettings()
        self.state = "IDLE"
        self.protection = Protection(bench)
        self.done = 0
        self.lost = 0
        self.flags = 0
        self.markers = [0, 0, 0]
        self.armed_s = self._ready_s = 0.0
        self.tags = TimeTags(bench)
        self._ring: dict[int, Slot] = {}
        self._read_until = 0
        self._gate: _OpenGate | None = None
        self._edge_s = NEVER_S
        self._edges = 0
        self._missed = 0
        self._next_s = NEVER_S
        self._advancing = False
        bench.follow(self.advance)
        for k, line in enumerate(("marker_1", "marker_2", "marker_4")):
            bench.wire(line, partial(self._count_marker, k))
        bench.wire("counter_trigger", self._external_edge)

    # Time

    def next_event_s(self) -> float:
        return self._next_s

    def advance(self, now_s: float) -> None:
        """Everything due by `now_s`, in order."""
        if self._advancing:
            return  # a step of ours moved the bench, which asks whether we are up to date
        self._bench.let_pass(now_s)
        now_s += _SLACK_S
        self._advancing = True
        try:
            while self._next_s <= now_s:
                self._step(self._next_s)
            if self.protection.interlock_opened:
                self._trip(INTERLOCK)
        finally:
            self._advancing = False

    def _step(self, when_s: float) -> None:
        if code := self.protection.due(when_s):
            self._trip(code)
        elif self._gate is not None and self._gate.closes_s <= when_s:
            self._close_gate()
        elif self._edge_s <= when_s:
            self._clock_edge(self._edge_s)
        self._schedule()

    def _schedule(self) -> None:
        closes_s = self._gate.closes_s if self._gate else NEVER_S
        self._next_s = min(self.protection.next_s, closes_s, self._edge_s)

    # Arming and triggering

    def arm(self, now_s: float) -> None:
        """`INIT`."""
        self.done = self.lost = self.flags = self._read_until = self._edges = self._missed = 0
        self.markers = [0, 0, 0]
        self._ring.clear()
        self.armed_s = self._ready_s = now_s
        self.state = "ARMED"
        if self.settings.mode == "T3":
            self.tags.start(now_s, self.sync_hz(now_s))
        self._edge_s = now_s if self.settings.source == "IMM" else NEVER_S
        self._schedule()

    def look(self, now_s: float) -> Exposure:
        """What inputs and detector do in the instrument's own rate window."""
        this = self.settings
        return self._bench.expose(
            Gate(now_s, RATE_WINDOW_S, this.bins, this.bin_width_ps * 1e-12, this.offset_ps * 1e-12, kept=False)
        )

    def sync_hz(self, now_s: float) -> float:
        """Laser pulses a second at the sync input."""
        return self.look(now_s).sync_count / RATE_WINDOW_S

    def abort(self) -> None:
        """`ABOR`: the gate closes; complete points stay readable."""
        self.tags.stop(self._bench.clock.now())
        self._gate = None
        self._edge_s = NEVER_S
        self.protection.gate_closed()
        if self.state in ("ARMED", "RUN", "DONE"):
            self.state = "IDLE"
        self._schedule()

    def trigger(self, now_s: float) -> None:
        """A bus trigger: opens the next gate, or is missed while one is open."""
        if self.settings.source == "BUS" and self.state in ("ARMED", "RUN"):
            self._triggered(now_s)

    def _external_edge(self, when_s: float) -> None:
        self.advance(when_s - 2 * _SLACK_S)
        if self.settings.source == "EXT" and self.state in ("ARMED", "RUN"):
            self._triggered(when_s)

    def _triggered(self, when_s: float) -> None:
        if self._gate is not None:
            self._gate.slot.flags |= HistogramFlag.TRIGGER_MISSED
            return
        self._open_gate(when_s + self.settings.blanking_us * 1e-6, when_s)
        self._schedule()

    def _clock_edge(self, when_s: float) -> None:
        """A pixel clock edge: the mirror steps, the gate opens after blanking. Without a clock, points just follow."""
        settings = self.settings
        self._edges += 1
        self._edge_s = NEVER_S
        if settings.clock_100ns:
            self._bench.edge("pixel_clock", when_s, self._period_s(self.done) / 2.0)
            fault = self._bench.faults.strikes("U15", when_s, "clock")
            if fault is not None:  # the counter itself overlooks the edge that the mirror has followed
                self._missed = HistogramFlag.TRIGGER_MISSED
                self._edge_s = when_s + self._period_s(self.done)
                return
        self._open_gate(when_s + settings.blanking_us * 1e-6, when_s)

    def _period_s(self, index: int) -> float:
        needed_us = self.settings.blanking_us + self._dwell_us(index)
        return max(needed_us * 1e-6, self.settings.clock_100ns * 1e-7)

    def _dwell_us(self, index: int) -> int:
        dwells = self.settings.dwells_us
        return dwells[index] if index < len(dwells) else dwells[-1]

    def _number(self, index: int) -> int:
        return self.settings.numbers[index] if index < len(self.settings.numbers) else index

    def _open_gate(self, opens_s: float, edge_s: float) -> None:
        settings, index = self.settings, self.done
        self.state = "RUN"
        dwell_s = self._dwell_us(index) * 1e-6
        number = self._number(index)
        gate = Gate(
            opens_s, dwell_s, settings.bins, settings.bin_width_ps * 1e-12, settings.offset_ps * 1e-12,
            number if settings.numbers else None, settings.stop_counts, settings.stop_window,
        )  # fmt: skip
        exposure = self._bench.expose(gate)
        if settings.mode == "T3":
            self.tags.expose(gate, exposure, settings.blanking_us * 1e-6)
        flags = self._missed
        self._missed = 0
        if exposure.stopped_early:
            flags |= HistogramFlag.STOPPED_EARLY
        if exposure.sync_count == 0:
            flags |= HistogramFlag.SYNC_LOST
        late_after_s = settings.trigger_timeout_ms * 1e-3
        if late_after_s and edge_s - self._ready_s > late_after_s:
            flags |= HistogramFlag.TRIGGER_LATE
        closes_s = opens_s + (exposure.live_s if exposure.stopped_early else dwell_s)
        if (fault := self._bench.faults.strikes("U15", opens_s)) is not None:
            flags |= _FLAGS[one_of(fault.parameters, "what", "missed", _FLAGS)]
        self.protection.watch(exposure, opens_s, closes_s, settings.trip_rate_hz, settings.trip_time_ms)
        self._gate = _OpenGate(Slot(index, number, gate, exposure, flags), closes_s)
        if settings.source == "IMM" and index + 1 < settings.points:
            period_s = settings.clock_100ns * 1e-7
            self._edge_s = max(closes_s, edge_s + period_s)

    def _close_gate(self) -> None:
        assert self._gate is not None
        slot, self._ready_s, self._gate = self._gate.slot, self._gate.closes_s, None
        if slot.flags & HistogramFlag.OVERRUN or self.done - self._read_until >= SLOTS:
            slot.flags |= HistogramFlag.OVERRUN
            if not self.lost:
                self._report(104)
            self.lost += 1
            self._read_until = max(self._read_until, self.done + 1 - SLOTS)
        self._ring[slot.index % SLOTS] = slot
        self.flags |= slot.flags
        self.done += 1
        if self.done == self.settings.points:
            self.state = "DONE"
            self._signal()
        else:
            self.state = "RUN" if self.settings.source == "IMM" else "ARMED"

    # Reading

    def slots(self, first: int, count: int) -> list[Slot] | None:
        """Complete points, or None where one is not complete or was overwritten. Frees those before them."""
        if count < 1 or first < 0 or first + count > self.done:
            return None
        slots = [self._ring[index % SLOTS] for index in range(first, first + count)]
        if slots[0].index != first:
            return None
        self._read_until = max(self._read_until, first + count)
        return slots

    @property
    def all_lost(self) -> int:
        """Points overwritten unread, or records that found the FIFO full."""
        return self.lost + self.tags.lost

    @property
    def free(self) -> int:
        """Slots that a new point may take."""
        return SLOTS - (self.done - self._read_until)

    def _count_marker(self, line: int, when_s: float) -> None:
        self.markers[line] += 1
        self.tags.mark(1 << line, when_s)

    # Protection

    def kick_watchdog(self, now_s: float, period_s: float | None = None) -> None:
        """`SYST:WDOG:KICK`, or `SYST:WDOG` with a period."""
        self.protection.kick(now_s, period_s)
        self._schedule()

    def _trip(self, code: int) -> None:
        """Shutter shut, gate shut, latched until a person clears it."""
        self.abort()
        self.protection.trip(code)
        self.state = "FAULT" if code == SYNC else "TRIP"
        self._report(code)
        self._signal()

    def clear_trip(self) -> None:
        self.protection.clear()
        if self.state in ("TRIP", "FAULT"):
            self.state = "IDLE"
