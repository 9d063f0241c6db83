"""Whether what a counter hands over can be counts of photons: asked of counters of other packages."""

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np

from nlos.drivers.plug_in_device import Misfit
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag

_MOST = np.iinfo(np.uint32).max
_WHY_NOT_LIVE = (
    HistogramFlag.STOPPED_EARLY | HistogramFlag.SYNC_LOST | HistogramFlag.OVERRUN | HistogramFlag.TRIGGER_MISSED
    | HistogramFlag.DATA_LOST
)  # fmt: skip


def answers_misfit() -> Misfit:
    """For one counter: remembers how it was configured, and judges its histograms and rates."""
    axis: HistogramAxis | None = None

    def misfit(method: str, given: Sequence[Any], answer: Any) -> str:
        nonlocal axis
        if method == "configure":
            axis = given[0]
        if method == "rates":
            return _negative(answer, "sync_hz", "detector_hz")
        if method != "read" or axis is None:
            return ""
        if not isinstance(answer, list) or len(answer) != given[1]:
            return f"{_many(answer)}, where {given[1]} were asked for"
        wrong = next(filter(None, (_misfit(each, axis) for each in answer)), "")
        if not wrong and len({id(each.counts) for each in answer}) < len(answer):
            return "one array for several points, of which only the last would be kept"
        return wrong

    return misfit


def _many(answer: Any) -> str:
    return f"a list of {len(answer)}" if isinstance(answer, list) else f"{type(answer).__name__}, no list"


def _misfit(read: Any, axis: HistogramAxis) -> str:
    if not isinstance(read, Histogram):
        return f"{type(read).__name__}, no Histogram"
    counts: Any = read.counts
    flags: Any = read.flags
    if not isinstance(counts, np.ndarray) or counts.dtype.kind not in "ui" or counts.shape != (axis.bins,):
        kind = f"{counts.dtype} {counts.shape}" if isinstance(counts, np.ndarray) else type(counts).__name__
        return f"counts are {kind}, must be whole numbers ({axis.bins},)"
    if counts.size and not (counts.min() >= 0 and counts.max() <= _MOST):
        return f"counts from {counts.min()} to {counts.max()}, must be 0 to {_MOST}"
    if read.bin_width_s != axis.bin_width_s:
        return f"bin_width_s is {read.bin_width_s:g}, configured were {axis.bin_width_s:g} s"
    if not isinstance(flags, HistogramFlag):
        return f"flags are {type(flags).__name__}, must be HistogramFlag"
    if wrong := _negative(read, "live_time_s", "sync_count", "total_count", "gate_opened_s"):
        return wrong
    if read.live_time_s == 0 and not flags & _WHY_NOT_LIVE:  # a night of such points holds no rates, and no picture
        return "live_time_s is 0, how long photons were accepted, and no flag says that the point was lost"
    return ""


def _negative(of: Any, *names: str) -> str:
    values = {name: getattr(of, name) for name in names}
    wrong = (f"{name} is {value}, must be a number from 0" for name, value in values.items() if not _is_amount(value))
    return next(wrong, "")


def _is_amount(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and isfinite(value) and bool(value >= 0)
