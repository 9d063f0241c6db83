"""What is left on the terminal when somebody stops watching: rates in light and dark, the direct peak, light's time."""

from dataclasses import dataclass, field
from typing import Any

from nlos.acquisition.digits import plus_minus
from nlos.acquisition.direct_peak import DirectPeak
from nlos.by_hand.hand import Hand
from nlos.by_hand.light import LightOnRequest
from nlos.by_hand.lines import rate


@dataclass
class _Counted:
    counts: int = 0
    live_s: float = 0.0

    @property
    def hz(self) -> float:
        return self.counts / self.live_s

    def __str__(self) -> str:
        return f"{plus_minus(self.hz, max(self.counts, 1) ** 0.5 / self.live_s)} counts/s"


@dataclass
class Summary:
    """Added to at every update; the peak is the last one that was seen, with its rate over a second at most."""

    light: LightOnRequest | None = None
    """None where nothing here switches it."""
    updates: int = 0
    _lit: dict[bool, _Counted] = field(default_factory=dict)
    _sync_hz: float = 0.0
    _peak: DirectPeak | None = None
    _peak_hz: float = 0.0

    def add(self, hand: Hand) -> None:
        """What was seen in one update."""
        reading, watch = hand.reading, hand.watch
        if reading is None or watch is None:
            return
        self.updates += 1
        self._sync_hz = reading.sync_hz
        if reading.lit is not None and reading.histogram.live_time_s > 0:
            counted = self._lit.setdefault(reading.lit, _Counted())
            counted.counts += reading.histogram.total_count
            counted.live_s += reading.histogram.live_time_s
        if hand.peak is not None:
            self._peak, self._peak_hz = hand.peak, hand.peak.counts / max(watch.summed_s, 1e-9)

    @property
    def light_s(self) -> float:
        """How long the light was on."""
        return 0.0 if self.light is None else self.light.on_s

    def line(self) -> str:
        """All of it in one line."""
        parts = [f"sync {rate(self._sync_hz, 'Hz')}"]
        words = {False: ""} if self.light is None else {True: " with light", False: " without"}
        parts += [f"{self._lit[lit]}{words[lit]}" for lit in words if lit in self._lit]
        if self._peak is None:
            parts.append("no direct peak")
        else:
            width = "-" if self._peak.fwhm_s is None else f"{self._peak.fwhm_s * 1e12:.0f} ps"
            parts.append(
                f"direct peak at {self._peak.time_s * 1e9:.3f} ns, FWHM {width}, {rate(self._peak_hz, 'counts/s')}"
            )
        if self.light is None:
            parts.append("light not known: this bench has no shutter")
        else:
            parts.append(f"light on for {self.light_s:.1f} s in all" if self.light_s > 0 else "light never on")
        return f"{self.updates} updates: {'; '.join(parts)}"

    def values(self) -> dict[str, Any]:
        """The same for `--json`."""
        return {
            "updates": self.updates,
            "light_s": None if self.light is None else round(self.light_s, 3),
            "lit_hz": None if True not in self._lit else round(self._lit[True].hz, 1),
            "dark_hz": None if self.light is None or False not in self._lit else round(self._lit[False].hz, 1),
        }
