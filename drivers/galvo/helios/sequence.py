"""Points as a frame of samples: how many samples each lasts, at which rate, and which colour outputs mark its first."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from nlos.drivers.galvo.helios import wire
from nlos.drivers.galvo.mirror import OwnSteps

_LEAST_RATE = 100
"""Samples a second: rates are whole numbers, so that a step is at most a hundredth longer than asked for."""
_CLOCKS_DIFFER = 2e-4
"""By how much the clocks of two instruments may differ: two crystals."""
_SPARE_S = 10e-6
"""Between a dwell and the next mark: a counter needs a moment to be ready again."""


@dataclass(frozen=True)
class Pace:
    """`samples` of the DAC a point, `rate` of them a second."""

    samples: int
    rate: int

    @property
    def step_s(self) -> float:
        """How long a point really takes."""
        return self.samples * wire.sample_s(self.rate)


def samples_a_point(dwell_s: float) -> int:
    """At least two: a mark has to fall before it can rise again."""
    return max(2, math.ceil(_LEAST_RATE * dwell_s))


def most_steps(dwell_s: float) -> int:
    """How many points of that dwell a frame holds; one more sample may be needed to spoil a whole packet."""
    return (wire.MOST_POINTS - 1) // samples_a_point(dwell_s)


def pace(dwell_s: float, settling_s: float) -> Pace:
    """The fastest for steps that hold settling, dwell and a little more. Raises `ValueError` where it is too slow for
    the DAC's clock."""
    least_s = settling_s + dwell_s * (1 + _CLOCKS_DIFFER) + _SPARE_S
    samples = samples_a_point(dwell_s)
    rate = min(math.floor(samples / least_s), wire.RATES[1])
    if rate < wire.RATES[0]:
        raise ValueError(f"{samples} samples in {least_s * 1e3:g} ms are fewer than {wire.RATES[0]} a second")
    return Pace(samples, rate)


def own_steps(dwell_s: float, settling_s: float) -> OwnSteps:
    """What the DAC's clock makes of that. Raises `ValueError` as `pace`."""
    this = pace(dwell_s, settling_s)
    spare_s = dwell_s * _CLOCKS_DIFFER + _SPARE_S
    whole_us = math.floor(round((this.step_s - dwell_s - spare_s) * 1e6, 3))
    return OwnSteps(dwell_s, settling_s, this.step_s, whole_us * 1e-6, wire.sample_s(this.rate))


def marked(points: Sequence[tuple[int, int]], samples: int, high: int) -> list[wire.Codes]:
    """Each point's codes `samples` times. With its first one I rises, and R and G in turn; B with the first of all."""
    frame = []
    for k, (x, y) in enumerate(points):
        turn = k % 2
        colours = bytes((high * (1 - turn), high * turn, high * (k == 0), high))
        frame += [wire.Codes(x, y, colours), *[wire.Codes(x, y)] * (samples - 1)]
    if wire.fills_packets(len(frame)):
        frame.append(frame[-1])
    return frame
