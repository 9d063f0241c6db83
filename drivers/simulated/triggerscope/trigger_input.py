"""The trigger input of a simulated TriggerScope, whichever firmware polls it: pulses become levels."""

from collections.abc import Callable

from nlos.drivers.simulated.bench import SimulatedBench

LEAST_PULSE_S = 10e-6
"""The firmware looks at the input once in its main loop: a shorter pulse comes and goes unseen."""


class TriggerInput:
    """Tells `follow(level, bench time)`. Commits fault A6 of docs/faults.md."""

    def __init__(self, bench: SimulatedBench, follow: Callable[[bool, float], object]) -> None:
        self.level = False
        self._bench = bench
        self._follow = follow
        self._falls_s: float | None = None  # when it is low again
        bench.wire_pulses("pixel_clock", self._rise, LEAST_PULSE_S)
        bench.follow(self.fall_if_due)

    def fall_if_due(self, now_s: float) -> None:
        """Before anything else happens at `now_s`."""
        if self._falls_s is not None and self._falls_s <= now_s:
            self._fall(self._falls_s)

    def _fall(self, when_s: float) -> None:
        self._falls_s, self.level = None, False
        self._follow(False, when_s)

    def _rise(self, when_s: float, width_s: float) -> None:
        fault = self._bench.faults.strikes("A6", when_s)
        kind = str(fault.parameters.get("kind", "missed")) if fault else ""
        for _ in range({"missed": 0, "extra": 2}.get(kind, 1)):
            if self._falls_s is not None:
                self._fall(min(self._falls_s, when_s))
            self.level, self._falls_s = True, when_s + width_s
            self._follow(True, when_s)
