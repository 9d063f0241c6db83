"""A counter that proves where its photons come from: each histogram spells out mirror codes, point and settings.

A digit is one lit bin of four, a dark one behind it. Photons of two points or two settings light two bins of a digit: a
mistake by one step is exact, never a blur. Where the shutter was closed every digit is missing; a beam on its way, or a
look at the rate meter, lights a bin that no digit has.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.plan import ScanPlan
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import Exposure, Gate
from nlos.drivers.tcspc.counter import HistogramAxis

PHOTONS = 6
SPAN_RAD = 1.4  # +-40 degrees
IN_FLIGHT = 500
_FIRST = 20
_DIGITS = {"x": 8, "y": 8, "number": 8, "bins": 10, "width_ps": 10, "offset_ps": 12, "dwell_us": 10}


@dataclass(frozen=True)
class Spelled:
    """What a histogram says about itself. `number` 0: the host did not say which point; else the point's plus 1."""

    x: int
    y: int
    number: int = 0
    bins: int = 0
    width_ps: int = 0
    offset_ps: int = 0
    dwell_us: int = 0


def code(angle_rad: float) -> int:
    return round((angle_rad / SPAN_RAD + 0.5) * 65535)


def spelled(said: Spelled) -> list[int]:
    """The bins that are lit."""
    lit, place = [], _FIRST
    for field, digits in _DIGITS.items():
        value = getattr(said, field)
        for digit in range(digits):
            lit.append(place + (value >> 2 * digit & 3))
            place += 5
    return lit


def read(counts: npt.NDArray[np.uint32]) -> Spelled:
    """Raises `ValueError` where the photons are not those of one point under one setting."""
    bins = set(np.flatnonzero(counts).tolist())
    values, place = {}, _FIRST
    for field, digits in _DIGITS.items():
        values[field] = 0
        for digit in range(digits):
            lit = [level for level in range(5) if place + level in bins]
            if len(lit) != 1 or lit == [4]:
                raise ValueError(f"digit {digit} of {field} lights {lit}")
            bins.discard(place + lit[0])
            values[field] |= lit[0] << 2 * digit
            place += 5
    if bins:
        raise ValueError(f"bins {sorted(bins)} belong to no digit; {IN_FLIGHT}: the beam was on its way")
    return Spelled(**values)


class CodedLight:
    """What the detector sees: where the beam points as the gate opens, and what the counter was told about the gate.

    `tells_settings`: the counter makes histograms itself; one that hands out photons knows neither axis nor dwell.
    """

    def __init__(self, axis: HistogramAxis, repetition_hz: float, tells_settings: bool) -> None:
        self._axis = axis
        self._repetition_hz = repetition_hz
        self._tells_settings = tells_settings

    def __call__(self, gate: Gate, beam: MirrorAngles, shutter_open: bool) -> Exposure:
        lit = [IN_FLIGHT]
        if gate.kept:
            lit = spelled(self._about(gate, beam))
        counts = np.zeros(gate.bins, np.uint32)
        # In time, so that a counter with an axis of its own spells the same on the host's.
        time_s = self._axis.offset_s + (np.array(lit) + 0.5) * self._axis.bin_width_s
        place = np.floor((time_s - gate.offset_s) / gate.bin_width_s).astype(int)
        if shutter_open:
            counts[place[(place >= 0) & (place < gate.bins)]] = PHOTONS
        return Exposure(counts, gate.dwell_s, round(gate.dwell_s * self._repetition_hz), int(counts.sum()), False)

    def _about(self, gate: Gate, beam: MirrorAngles) -> Spelled:
        x, y = code(beam.x_rad), code(beam.y_rad)
        if not self._tells_settings:
            return Spelled(x, y)
        return Spelled(
            x,
            y,
            0 if gate.number is None else gate.number + 1,
            gate.bins,
            round(gate.bin_width_s * 1e12),
            round(gate.offset_s * 1e12),
            round(gate.dwell_s * 1e6),
        )


def expected(plan: ScanPlan, angles: list[MirrorAngles], number: int, tells_settings: bool) -> Spelled:
    x, y = code(angles[number].x_rad), code(angles[number].y_rad)
    if not tells_settings:
        return Spelled(x, y)
    axis = plan.axis
    width_ps, offset_ps = round(axis.bin_width_s * 1e12), round(axis.offset_s * 1e12)
    return Spelled(x, y, number + 1, axis.bins, width_ps, offset_ps, round(plan[number].dwell_s * 1e6))
