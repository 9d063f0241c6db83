"""One axis of a mirror on its way from one angle to the next."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Swing:
    """From `start_rad` at `start_s` to `end_rad` at `end_s`, with no speed at either end; at rest before and after."""

    start_rad: float
    end_rad: float
    start_s: float
    end_s: float

    def at(self, when_s: float) -> float:
        """The angle at `when_s`."""
        if when_s >= self.end_s:
            return self.end_rad
        if when_s <= self.start_s:
            return self.start_rad
        progress = (when_s - self.start_s) / (self.end_s - self.start_s)
        return self.start_rad + (self.end_rad - self.start_rad) * (1.0 - math.cos(math.pi * progress)) / 2.0

    def towards(self, end_rad: float, when_s: float, settle_s: float) -> "Swing":
        """Sent elsewhere at `when_s`; sent to where it already goes, it just continues."""
        if end_rad == self.end_rad:
            return self
        return Swing(self.at(when_s), end_rad, when_s, when_s + settle_s)
