"""What the detector made of the light, undone: dead time and pile-up, afterpulses, dark counts."""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.calibration.afterpulsing import ClickAfterClick, subtract_afterpulses
from nlos.calibration.background import subtract
from nlos.calibration.by_blocks import some_at_a_time
from nlos.calibration.constants import BenchConstants, Quantity
from nlos.calibration.dead_time import blind_pulses, correct_free_running
from nlos.calibration.first_click import correct_first_click, first_click
from nlos.calibration.raw_points import RawPoints

WHOLE_PERIOD = 0.01
"""A histogram covers the laser's period when its length differs by no more than this share."""


def undo_dead_time(
    raw: RawPoints, constants: BenchConstants | None
) -> tuple[npt.NDArray[np.generic], npt.NDArray[np.generic]]:
    """Counts and their variance with dead time, pile-up and, over a whole period, afterpulses undone; as they are where
    laser pulses are not known. Where the dead time is not, and many pulses click, pile-up is undone as of one click a
    pulse, unless the clicks speak against it. The variance of bins that cannot be told is infinite."""
    period_s = raw.period_s
    if period_s is None:
        return raw.counts, raw.counts
    dead_time = None if constants is None else constants.dead_time_s
    if dead_time is None:
        found = first_click(raw)
        if found.one_a_pulse:
            return correct_first_click(raw.counts, raw.sync_count)
        dead_time = found.dead_time
    if dead_time is None or not dead_time.value > 0:
        return raw.counts, raw.counts
    taken = raw.sync_count > 0
    if taken.all():
        return _free_running(raw, dead_time, period_s, constants)
    counts, variance = raw.counts.astype(np.float32), raw.counts.astype(np.float32)
    counts[taken], variance[taken] = _free_running(raw.select(taken), dead_time, period_s, constants)
    return counts, variance


def _free_running(
    raw: RawPoints, dead_time: Quantity, period_s: float, constants: BenchConstants | None
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """`undo_dead_time` of a known dead time."""
    width_s = raw.time.bin_width_s
    counts, variance = correct_free_running(raw.counts, raw.sync_count, raw.total_count, width_s, period_s, dead_time)
    after = None if constants is None else constants.afterpulse_probability
    decay_s = None if constants is None else constants.afterpulse_decay_s
    whole_period = abs(raw.time.bins * width_s / period_s - 1) < WHOLE_PERIOD
    if after is not None and decay_s is not None and after.value > 0 and whole_period:
        once = slice(min(raw.time.bins, round(period_s / width_s)))  # of a record that is a little longer
        found = ClickAfterClick(dead_time.value, 0.0, after.value, after.error, decay_s)
        for some in some_at_a_time(len(counts)):
            total, pulses = raw.total_count[some], raw.sync_count[some]
            clicks, every = raw.counts[some, once].astype(np.float64), pulses[:, None]
            live = 1 - blind_pulses(clicks, total, width_s, period_s, dead_time.value, pulses) / every
            seen = counts[some, once].astype(np.float64) / every
            counts[some, once] = every * subtract_afterpulses(seen, clicks / every, live, found, width_s)
    return counts, variance


def subtract_dark(
    counts: npt.NDArray[np.generic], raw: RawPoints, constants: BenchConstants | None
) -> npt.NDArray[np.generic]:
    """Counts less the dark counts expected in each bin, where a shutter-closed run told them."""
    per_bin = None if constants is None else _dark_per_bin_hz(constants, raw.time)
    if per_bin is None:
        return counts
    left = np.empty(counts.shape, dtype=np.float32)
    for some in some_at_a_time(len(counts)):
        left[some] = subtract(counts[some], np.multiply.outer(raw.exposure_s[some], per_bin))
    return left


def _dark_per_bin_hz(constants: BenchConstants, time: TimeAxis) -> npt.NDArray[np.float64] | None:
    """In the bins of `time` (T,): the dark run's own where it had the same, else its counts as they lie in time, and
    its mean where it recorded none. A file that does not say when its bins were is believed for bins like its own."""
    told, axis = constants.dark_per_bin_hz, constants.dark_time
    if told is None or axis == time:
        return told
    if axis is None:
        same = len(told) == time.bins and np.isclose(constants.bin_width_s, time.bin_width_s, rtol=1e-6)
        return told if same else None
    edges_s = axis.start_s + np.arange(axis.bins + 1) * axis.bin_width_s
    wanted_s = time.start_s + np.arange(time.bins + 1) * time.bin_width_s
    inside_s = np.clip(wanted_s, edges_s[0], edges_s[-1])
    held = np.diff(np.interp(inside_s, edges_s, np.append(0.0, np.cumsum(told))))
    beside_s = time.bin_width_s - np.diff(inside_s)
    return np.asarray(held + beside_s * told.mean() / axis.bin_width_s)
