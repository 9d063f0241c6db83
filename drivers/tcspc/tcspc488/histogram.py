"""The `tcspc488` histogrammer: points armed in one go, gated one by one or by the pixel clock, read while others run.

In scheme S1 one question per point both confirms that its gate has closed and brings its record; the record is
checked in `read`, while the mirror moves on.
"""

from collections.abc import Callable, Sequence
from itertools import accumulate

from nlos.drivers.errors import CommandRejected, DeviceReset, DeviceTimeout, LimitError
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.tcspc.counter import (
    CounterStatus,
    CountRates,
    Histogram,
    HistogramAxis,
    PointGates,
    StopAtCounts,
    Trigger,
)
from nlos.drivers.tcspc.tcspc488.instrument import Instrument
from nlos.drivers.tcspc.tcspc488.messages import (
    WIDTHS,
    Status,
    arm_commands,
    axis_commands,
    microseconds,
    stop_commands,
)
from nlos.drivers.tcspc.tcspc488.reading import checked, read_records
from nlos.drivers.tcspc.tcspc488.records import record_bytes
from nlos.drivers.tcspc.tcspc488.settings import Tcspc488Settings
from nlos.drivers.tcspc.time_axis import nearest_axis

_SHORT_WAIT_S = 0.01
_EARLY_S = 0.002
"""How often a gate that may end early is looked at."""
POLL_S = 0.05
"""Longest time between two looks at the status: a lost service request costs no more (20 Hz)."""


class Tcspc488:
    """A `HistogramCounter`. Made by `open_tcspc488`."""

    has_pixel_clock = True
    has_watchdog = True
    list_mode = False

    def __init__(self, settings: Tcspc488Settings, instrument: Instrument) -> None:
        self.instrument = instrument
        self.clock = instrument.clock
        self._device = settings.model
        self._settings = settings
        self._wide = settings.counts == "u32"
        self._axis: HistogramAxis | None = None
        self._stops = False
        self._numbers: Sequence[int] = ()
        self._due_s: list[float] = []
        self._dwells_s: Sequence[float] = ()
        self._trigger = Trigger.HOST
        self._triggered = 0
        self._gate_due_s = 0.0
        self._brought: tuple[int, memoryview] | None = None

    @property
    def identity(self) -> DeviceIdentity:
        return self.instrument.identity

    @property
    def warnings(self) -> list[str]:
        """What a person should know of this instrument."""
        return self.instrument.warnings

    # Settings

    @property
    def counts_markers(self) -> bool:
        return self._settings.markers

    @property
    def follows_mirror(self) -> bool:
        """Whether one of its edges a point comes in at the trigger input, and its marks at the marker inputs."""
        return self._settings.markers and self._settings.mirror_steps

    @property
    def max_points(self) -> int:
        return self.instrument.capacity.max_points

    def check(self, axis: HistogramAxis, dwell_s: float, stop: StopAtCounts | None = None) -> None:
        """Raises `LimitError` where axis, dwell or stop cannot be set exactly. Sends nothing."""
        axis_commands(self._device, axis, self.instrument.capacity)
        stop_commands(self._device, axis, stop)
        microseconds(self._device, dwell_s)

    def nearest_axis(self, axis: HistogramAxis) -> HistogramAxis:
        base_s = self.instrument.capacity.base_ps * 1e-12
        return nearest_axis(self._device, axis, [base_s * 2**code for code in range(WIDTHS)], 1e-12)

    def configure(self, axis: HistogramAxis, stop: StopAtCounts | None = None) -> None:
        """Sets and reads back. A latched trip is `SafetyTrip` here, before anybody turns the light on."""
        commands = axis_commands(self._device, axis, self.instrument.capacity) | stop_commands(self._device, axis, stop)
        with self.instrument.errors_named():
            self.instrument.setup.apply(commands)
            if self._axis is not None:  # since it was set up first, it may have been switched off and on
                self.instrument.restore({})
        self._axis, self._stops = axis, stop is not None
        if self.instrument.look()[0].tripped:
            self.instrument.tripped(())

    def arm(self, gates: PointGates) -> None:
        """Gets ready for the points; every setting is read back before the instrument is started. With
        `Trigger.MIRROR` each edge at the trigger input begins the next one."""
        gates.check(self._device, self._axis, self.max_points)
        trigger, numbers = gates.trigger, gates.numbers
        dwells_us = [microseconds(self._device, each) for each in gates.dwells_s]
        blanking_us = microseconds(self._device, gates.blanking_s) if gates.blanking_s else 0
        commands, lists = arm_commands(dwells_us, trigger, blanking_us, self._stops, "T3" if self.list_mode else "HIST")
        lists["ACQ:NUMB:LIST"] = list(numbers)
        self.instrument.initiate(commands, lists)
        self._dwells_s, self._numbers, self._trigger = gates.dwells_s, numbers, trigger
        self._triggered, self._brought = 0, None
        start_s = self.clock.now()
        steps_s = (gates.step_s or (us + blanking_us) * 1e-6 for us in dwells_us)
        self._due_s = [start_s + each for each in accumulate(steps_s)]

    # Acquiring

    def trigger(self) -> None:
        if self._triggered >= len(self._numbers):
            raise CommandRejected(self._device, f"all {len(self._numbers)} armed points are triggered.", "Arm again.")
        self.instrument.trigger()
        self._gate_due_s = self.clock.now() + self._dwells_s[self._triggered]
        self._triggered += 1

    def wait_points(self, count: int, timeout_s: float) -> CounterStatus:
        deadline_s = self.clock.now() + timeout_s
        by_host = self._trigger is Trigger.HOST
        due_s = self._due(count)
        again_s = 0.0005
        look_s = self.clock.now() + _EARLY_S if self._stops else due_s
        while True:
            self._pause(min(due_s, look_s, deadline_s))
            now_s = self.clock.now()
            wanted = count - 1 if by_host and now_s >= min(due_s, look_s) else None
            status = self._poll(wanted)
            self._running_or_done(status)
            if status.done >= count:
                return CounterStatus(status.running, status.done, status.lost, status.markers, self._steps_due(status))
            if now_s >= deadline_s:
                raise DeviceTimeout(self._device, f"{status.done} of {count} points complete after {timeout_s:g} s.")
            look_s = now_s + _EARLY_S if self._stops else due_s
            if now_s >= due_s:
                due_s, again_s = now_s + again_s, min(2 * again_s, POLL_S)

    def rest(self, seconds: float) -> bool:
        until_s = self.clock.now() + seconds
        while self.clock.now() < until_s:
            self._pause(until_s)
            status = self._look()
            self._running_or_done(status)
            if status.done >= self._triggered:
                return False
        return True

    def meanwhile(self, look: Callable[[], None]) -> None:
        self.instrument.meanwhile = look

    def _look(self) -> Status:
        return self.instrument.look()[0]

    def _due(self, count: int) -> float:
        """When the gates of that many points should have closed. Raises `CommandRejected` for one not triggered."""
        if self._trigger is not Trigger.HOST:
            return self._due_s[min(count, len(self._due_s)) - 1]
        if count > self._triggered:
            raise CommandRejected(self._device, f"{count} points wanted, {self._triggered} triggered.", "Trigger.")
        return self._gate_due_s

    def _steps_due(self, status: Status) -> int:
        """The mirror has taken a step for each point that was begun: one more than are done, until all are."""
        return min(status.done + 1, len(self._numbers))

    def _running_or_done(self, status: Status) -> None:
        if status.tripped:
            self.instrument.tripped(())
        if status.state == "IDLE" and status.done < len(self._numbers):
            raise DeviceReset(self._device, f"it stopped by itself after {status.done} of {len(self._numbers)} points.")

    def _pause(self, until_s: float) -> None:
        """Sleeps at most until `until_s`; a service request or the next look at the status ends a long sleep early."""
        left_s = until_s - self.clock.now()
        if left_s <= _SHORT_WAIT_S:
            self.clock.sleep(left_s)
        else:
            self.instrument.pause(min(left_s - 0.5 * _SHORT_WAIT_S, POLL_S))

    def _poll(self, wanted: int | None) -> Status:
        """The status, with the record of point `wanted` brought along if it is complete."""
        if wanted is None:
            return self.instrument.look()[0]
        status, block = self._ask_for(wanted, 1)
        if block is not None:
            self._brought = (wanted, block)
        return status

    def _ask_for(self, first: int, count: int) -> tuple[Status, memoryview | None]:
        assert self._axis is not None
        expected = count * record_bytes(self._axis.bins, self._wide)
        return self.instrument.look(b"ACQ:DATA? %d,%d" % (first, count), expected)

    def read(self, first: int, count: int) -> list[Histogram]:
        """The histograms of points `first`.. since `arm`. A record that is damaged twice, or was overwritten before it
        was read, comes back empty and flagged `DATA_LOST`."""
        if self._axis is None or not 0 <= first <= first + count <= len(self._numbers):
            raise LimitError(self._device, f"points {first} to {first + count - 1} of {len(self._numbers)} armed.")
        if self._brought is not None and count == 1 and self._brought[0] == first:
            return [checked(self._fetch, self._brought[1], self._numbers, first, self._axis, self._wide)]
        return read_records(self._fetch, self._numbers, first, count, self._axis, self._wide)

    def _fetch(self, first: int, count: int) -> memoryview | None:
        """The records' block, or None where the instrument no longer has them."""
        status, block = self._ask_for(first, count)
        if block is None and status.done < first + count:
            if status.state == "IDLE" and status.done == 0:
                raise DeviceReset(self._device, "it has forgotten the points it had taken.", "Arm again.")
            raise CommandRejected(self._device, f"point {first + count - 1} is not complete ({status.done} are).")
        return block

    def abort(self) -> None:
        self.instrument.call(b"ABOR")
        self._brought = None

    # Protection

    def rates(self) -> CountRates:
        return self.instrument.rates()

    def arm_watchdog(self, timeout_s: float) -> None:
        self.instrument.arm_watchdog(timeout_s)

    def kick(self) -> None:
        self.instrument.kick()

    def clear_trip(self) -> None:
        """Clears a latched trip. For a person to call, after finding out why."""
        self.instrument.clear_trip()

    def close(self) -> None:
        """Stops, if the instrument still listens, and releases it."""
        self.instrument.close()
