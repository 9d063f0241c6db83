"""The sync input of a counter that times laser pulses: a divider, and behind it a converter that is blind for a while.

A pulse within that dead time is missed. The instrument does not know, and reckons the pulses between those it sees as
if it had seen them all: photons are timed from an earlier pulse, and fewer pulses are counted. What the rate meter then
says the manuals leave open; here it counts what is seen, which is the worse case for who trusts it.
"""

import math

import numpy as np
import numpy.typing as npt

from nlos.drivers.simulated import spad
from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench

Integers = npt.NDArray[np.int64]


class SyncInput:
    """What the instrument makes of the laser's pulses."""

    def __init__(self, laser_hz: float, dead_s: float = 0.0) -> None:
        self._laser_hz, self._dead_s = laser_hz, dead_s
        self.divider = 1

    @property
    def every(self) -> int:
        """Of so many laser pulses one counts."""
        return max(1, math.ceil(self._dead_s * self._laser_hz / self.divider - 1e-9))

    @property
    def rate_hz(self) -> float:
        """On the rate meter."""
        return self._laser_hz / self.every

    def timed(self, pulses: Integers, bins: Integers, bin_width_s: float) -> tuple[Integers, Integers]:
        """Photons by laser pulse and bin after it, as the instrument numbers and times them."""
        if self.every == 1:
            return pulses, bins
        later = np.round((pulses % self.every) / (self._laser_hz * bin_width_s)).astype(np.int64)
        return pulses // self.every, bins + later

    def histogram(self, bench: SimulatedBench, gate: Gate, seed: int) -> npt.NDArray[np.uint32]:
        """Counts (bins,) of a gate, timed so."""
        if self.every == 1:
            return bench.expose(gate).counts
        whole = Gate(
            gate.opened_s, gate.dwell_s, round(1 / (self._laser_hz * gate.bin_width_s)), gate.bin_width_s, 0.0,
            gate.number,
        )  # fmt: skip
        exposure: Exposure = bench.expose(whole)
        _, bins = self.timed(
            *spad.arrivals(exposure, np.random.default_rng((seed, gate.number or 0))), gate.bin_width_s
        )
        bins -= round(gate.offset_s / gate.bin_width_s)
        inside = bins[(bins >= 0) & (bins < gate.bins)]
        return np.bincount(inside, minlength=gate.bins).astype(np.uint32)
