"""What the counter sees now: one short gate after the other, and their sum over the last second."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.direct_peak import DirectPeak, direct_peak
from nlos.by_hand.light import LightOnRequest
from nlos.drivers.clock import Clock
from nlos.drivers.partial_bench import PartialBench
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramCounter, PointGates

DWELL_S = 0.04
_AT_ONCE = 63
_GRACE_S = 2.0
_SUMMED = 25
_WHOLE = 0.98


@dataclass(frozen=True)
class Reading:
    """One gate, and the light's state while it was open: None where that changed."""

    when_s: float
    histogram: Histogram
    lit: bool | None

    @property
    def sync_hz(self) -> float:
        return self.histogram.sync_count / self.histogram.live_time_s if self.histogram.live_time_s else math.nan

    @property
    def detector_hz(self) -> float:
        return self.histogram.total_count / self.histogram.live_time_s if self.histogram.live_time_s else math.nan


class Watch:
    """Gates of 40 ms on one time axis. `summed` holds those since `forget` or of the last second, of one kind of
    light."""

    def __init__(self, bench: PartialBench, light: LightOnRequest, axis: HistogramAxis) -> None:
        assert bench.counter is not None
        self._counter: HistogramCounter = bench.counter
        self._clock: Clock = bench.clock
        self._shutter, self._light = bench.shutter, light
        self._repetition_hz = bench.settings.laser.repetition_hz
        self._index, self._number, self._armed = 0, 0, 0
        self._kept: deque[Reading] = deque(maxlen=_SUMMED)
        self.axis = axis
        self.set_axis(axis)

    @property
    def counter(self) -> HistogramCounter:
        return self._counter

    def set_axis(self, axis: HistogramAxis) -> None:
        """From now on on this axis."""
        self._counter.abort()
        self._counter.configure(axis)
        self.axis, self._armed, self._index = axis, 0, 0
        self.forget()

    @property
    def whole(self) -> bool:
        """Whether the axis covers the laser's period."""
        return self.axis.offset_s == 0 and self.axis.bins * self.axis.bin_width_s * self._repetition_hz > _WHOLE

    def look(self) -> Reading:
        """The next gate. Raises `SafetyTrip` with the light off where too many photons come, and `DeviceError`."""
        if self._index == self._armed:
            self._counter.arm(PointGates([DWELL_S] * _AT_ONCE, range(self._number, self._number + _AT_ONCE)))
            self._armed, self._index = _AT_ONCE, 0
            self._number += _AT_ONCE
        before, openings = self._light.lit, self._light.openings
        self._counter.trigger()
        self._counter.wait_points(self._index + 1, timeout_s=_GRACE_S)
        histogram = self._counter.read(self._index, 1)[0]
        self._index += 1
        lit = before if (before, openings) == (self._light.lit, self._light.openings) else None
        if self._shutter is not None and lit is not False:  # light of a part of the gate is too much light, too
            self._shutter.watch(histogram)
        reading = Reading(self._clock.now(), histogram, lit)
        if self._kept and lit is not None and self._kept[-1].lit != lit:
            self.forget()
        if lit is not None:
            self._kept.append(reading)
        return reading

    def forget(self) -> None:
        """The beam or the light has changed: what came before says nothing any more."""
        self._kept.clear()

    @property
    def summed(self) -> npt.NDArray[np.int64]:
        """Counts (T,) of the gates that are kept."""
        if not self._kept:
            return np.zeros(self.axis.bins, np.int64)
        rows = [each.histogram.counts for each in self._kept]
        return np.asarray(np.sum(rows, axis=0, dtype=np.int64))[: self._period_bins]

    @property
    def summed_s(self) -> float:
        return sum(each.histogram.live_time_s for each in self._kept)

    def peak(self) -> DirectPeak | None:
        """The direct peak in what is kept."""
        return direct_peak(self.summed, self.axis, self.whole)

    @property
    def _period_bins(self) -> int:
        """Bins beyond the period hold nothing."""
        return (
            min(self.axis.bins, round(1 / self._repetition_hz / self.axis.bin_width_s))
            if self.whole
            else self.axis.bins
        )
