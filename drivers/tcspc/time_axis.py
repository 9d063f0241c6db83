"""The time axis that a counter has nearest to the one asked for: its own bin width, and no less of the window."""

import math
from collections.abc import Sequence

from nlos.drivers.errors import LimitError
from nlos.drivers.tcspc.counter import HistogramAxis

_FURTHEST = 1.5
"""A width further off than this is another measurement: powers of two are never further than their square root."""
_SAME = 1e-6


def nearest_axis(
    device: str, axis: HistogramAxis, widths_s: Sequence[float], offset_unit_s: float | None = None
) -> HistogramAxis:
    """`axis` where the counter has it, else its window on the nearest of `widths_s`, begun at or before it and ended at
    or after it. Offsets are whole `offset_unit_s`, or whole bins. Raises `LimitError` naming the widths where none is
    near."""
    width_s = min(widths_s, key=lambda each: abs(math.log(each / axis.bin_width_s)))
    if not 1 / _FURTHEST < width_s / axis.bin_width_s < _FURTHEST:
        raise LimitError(
            device,
            f"bin width {_ps(axis.bin_width_s)} ps is far from any that it has.",
            f"Set histogram.bin_width_ps to one of {', '.join(_ps(each) for each in sorted(widths_s))}.",
        )
    unit_s = offset_unit_s or width_s
    same = abs(width_s / axis.bin_width_s - 1) < _SAME
    steps = axis.offset_s / unit_s
    if same and abs(steps - round(steps)) < 1e-3:
        return axis
    begin_s = math.floor(steps + 1e-3) * unit_s
    end_s = axis.offset_s + axis.bins * axis.bin_width_s
    return HistogramAxis(math.ceil((end_s - begin_s) / width_s - 1e-3), width_s, begin_s)


def nearest_whole_ps(axis: HistogramAxis) -> HistogramAxis:
    """For counters whose bins are any whole number of picoseconds, and whose offsets are whole bins."""
    return nearest_axis("counter", axis, [max(1, round(axis.bin_width_s * 1e12)) * 1e-12])


def cannot_stop(device: str) -> LimitError:
    """What a counter says that is asked to end points at a number of counts and has no such thing."""
    what = "it cannot stop a point at a number of counts within a window."
    return LimitError(device, what, "Use `exposure: {kind: two_pass, ...}` in the scan file, or an even dwell.")


def _ps(seconds: float) -> str:
    return f"{seconds * 1e12:g}"
