"""Time axes of a counter: its own bin widths, over the laser's whole period or a part of it."""

import math

from nlos.drivers.errors import LimitError
from nlos.drivers.tcspc.counter import HistogramAxis, HistogramCounter

MOST_BINS = 8192
"""What is read out ten times a second and more."""
FEWEST_BINS = 64
_WIDTHS_PS = sorted({base * 2**power for base in (1.0, 5.0, 10.0, 25.0) for power in range(14)} | {80.955, 0.965})


def whole_period(counter: HistogramCounter, repetition_hz: float, dwell_s: float) -> HistogramAxis:
    """All of the time between two laser pulses, in the finest bins that the counter has for it."""
    return part_of_period(counter, 0.0, 1 / repetition_hz, dwell_s)


def part_of_period(
    counter: HistogramCounter, start_s: float, end_s: float, dwell_s: float, most_bins: int = MOST_BINS
) -> HistogramAxis:
    """At least `start_s` to `end_s` after the sync pulse, in the finest bins of which that takes no more than
    `most_bins`. Raises `LimitError` where the counter has no such axis."""
    refused: LimitError | None = None
    for width_ps in _WIDTHS_PS:
        width_s = width_ps * 1e-12
        grain_s = _grain_s(width_s)
        offset_s = math.floor(start_s / grain_s + 1e-9) * grain_s
        bins = max(FEWEST_BINS, math.ceil((end_s - offset_s) / width_s - 1e-9))
        if bins > most_bins:
            continue
        axis = HistogramAxis(bins, width_s, offset_s)
        try:
            counter.check(axis, dwell_s)
        except LimitError as error:
            refused = error
            continue
        return axis
    raise refused or LimitError("counter", f"no bins of it cover {(end_s - start_s) * 1e9:g} ns.")


def _grain_s(width_s: float) -> float:
    """Offsets that every counter can set: whole nanoseconds and whole bins."""
    width_ps = max(1, round(width_s * 1e12))
    return math.lcm(width_ps, 1000) * 1e-12
