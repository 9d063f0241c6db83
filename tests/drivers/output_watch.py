"""Watches the outputs of a simulated TriggerScope: light that no scan asked for, axes beyond their limits."""

from dataclasses import dataclass, field

from nlos.drivers.simulated.triggerscope.wiring import SPAN_V, Wiring


@dataclass
class OutputWatch:
    """A log of `wiring` that judges. What happens while `ours` is False is another program's doing."""

    wiring: Wiring
    shutter_pin: int
    limit_v: float
    ours: bool = False
    scanning: bool = False
    light: int = 0
    """How often the shutter's pin rose without a scan."""
    left_limits_lit: int = 0
    """How often an axis was sent beyond its limits while the shutter was open."""
    longest_s: float = 0.0
    """How long an axis stayed beyond them at most."""
    events: list[tuple[float, str, int, int]] = field(default_factory=list)
    _beyond: dict[int, tuple[float, bool]] = field(default_factory=dict)  # since when, and whether by us

    def __post_init__(self) -> None:
        self._range = dict.fromkeys((self.wiring.x_dac, self.wiring.y_dac), 1)
        self._lit = False
        self.wiring.log = self

    def __call__(self, when_s: float, what: str, number: int, value: int) -> None:
        self.events.append((when_s, what, number, value))
        if what == "pin" and number == self.shutter_pin:
            self._lit = bool(value)
            self.light += self._lit and self.ours and not self.scanning
        elif what == "range" and number in self._range:
            self._range[number] = value
        elif what == "code" and number in self._range:
            self._coded(when_s, number, value)

    @property
    def is_beyond(self) -> bool:
        """Whether an axis is beyond its limits now."""
        return bool(self._beyond)

    def _coded(self, when_s: float, dac: int, code: int) -> None:
        since_s, by_us = self._beyond.pop(dac, (when_s, self.ours))
        if by_us:
            self.longest_s = max(self.longest_s, when_s - since_s)
        low_v, high_v = SPAN_V[self._range[dac]]
        if abs(low_v + (high_v - low_v) * code / 65536) > self.limit_v:
            self._beyond[dac] = (since_s, by_us)
            self.left_limits_lit += self.ours and self._lit
