"""What makes a simulated `tcspc488` shut the light off by itself: too many counts, interlock, lost sync, watchdog."""

from nlos.drivers.simulated.bench import Exposure, SimulatedBench
from nlos.drivers.simulated.faults import one_of

NEVER_S = float("inf")
OVER_COUNT, INTERLOCK, SYNC, WATCHDOG = 101, 102, 103, 105
TRIPS = {OVER_COUNT: "OVER", INTERLOCK: "INTL", SYNC: "SYNC", WATCHDOG: "WDOG"}
_FAULTS = {"over_count": OVER_COUNT, "interlock": INTERLOCK, "sync": SYNC, "watchdog": WATCHDOG}


class Protection:
    """The shutter's drive, and when it will be let go. `tripped` is latched."""

    def __init__(self, bench: SimulatedBench) -> None:
        self._bench = bench
        self.tripped = 0
        self.shutter_commanded = False
        self.watchdog_s = 0.0
        self._watchdog_due_s = NEVER_S
        self._coming = (NEVER_S, 0)
        self._over_since_s = NEVER_S

    @property
    def next_s(self) -> float:
        """When the next trip is due."""
        return min(self._coming[0], self._watchdog_due_s)

    @property
    def interlock_opened(self) -> bool:
        """The loop was opened by hand while the shutter was to be open: that has no time of its own."""
        return self.shutter_commanded and not self._bench.interlock_closed

    def due(self, when_s: float) -> int:
        """The trip that is due by then, or 0."""
        if self._coming[0] <= when_s:
            return self._coming[1]
        if self._watchdog_due_s <= when_s:
            self._watchdog_due_s = NEVER_S
            return WATCHDOG if self.shutter_commanded else 0
        return 0

    def watch(self, exposure: Exposure, opens_s: float, closes_s: float, most_hz: int, time_ms: int) -> None:
        """Foresees the trip that a gate's light, or a fault U14, will cause."""
        if most_hz and exposure.total_count > most_hz * exposure.live_s:
            self._over_since_s = min(self._over_since_s, opens_s)
            trips_s = max(self._over_since_s + time_ms * 1e-3, opens_s)
            if trips_s <= closes_s:
                self._coming = (trips_s, OVER_COUNT)
        else:
            self._over_since_s = NEVER_S
        if (fault := self._bench.faults.strikes("U14", opens_s)) is not None:
            cause = _FAULTS[one_of(fault.parameters, "cause", "over_count", _FAULTS)]
            self._coming = (opens_s + 0.5 * (closes_s - opens_s), cause)

    def gate_closed(self) -> None:
        """Nothing is foreseen for a gate that is not open any more."""
        self._coming = (NEVER_S, 0)

    def kick(self, now_s: float, period_s: float | None = None) -> None:
        """Restarts the watchdog, with a new period (0: off) where one is given."""
        if period_s is not None:
            self.watchdog_s = period_s
            self._bench.witness(now_s, f"watchdog {period_s:g}")
        self._watchdog_due_s = now_s + self.watchdog_s if self.watchdog_s else NEVER_S

    def command_shutter(self, is_open: bool) -> None:
        """Drives the output; a shutter that hangs on something else does not care whether it is let go."""
        if is_open or self.shutter_commanded:
            self._bench.set_shutter(is_open)
        self.shutter_commanded = is_open

    def trip(self, code: int) -> None:
        """Shuts the light off and remembers why."""
        self.command_shutter(False)
        self.tripped = code

    def clear(self) -> None:
        """Forgets the cause; the shutter stays closed."""
        self.tripped = 0
        self._over_since_s = NEVER_S
