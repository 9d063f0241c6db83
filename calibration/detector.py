"""What the detector made of the light, undone: dead time and pile-up, afterpulses, dark counts."""

import numpy as np
import numpy.typing as npt

from nlos.calibration.afterpulsing import subtract_afterpulses
from nlos.calibration.background import subtract
from nlos.calibration.constants import BenchConstants
from nlos.calibration.dead_time import correct_free_running
from nlos.calibration.raw_points import RawPoints

WHOLE_PERIOD = 0.01
"""A histogram covers the laser's period when its length differs by no more than this share."""


def undo_dead_time(
    raw: RawPoints, constants: BenchConstants | None
) -> tuple[npt.NDArray[np.generic], npt.NDArray[np.generic]]:
    """Counts and their variance with dead time, pile-up and, over a whole period, afterpulses undone; as they are where
    constants or laser pulses are not known."""
    period_s = raw.period_s
    if constants is None or constants.dead_time_s is None or not constants.dead_time_s.value > 0 or period_s is None:
        return raw.counts, raw.counts
    dead_s = constants.dead_time_s.value
    taken = raw.sync_count > 0
    if not taken.all():
        counts, variance = raw.counts.astype(np.float64), raw.counts.astype(np.float64)
        counts[taken], variance[taken] = undo_dead_time(raw.select(taken), constants)
        return counts, variance
    width_s = raw.time.bin_width_s
    counts, variance = correct_free_running(raw.counts, raw.sync_count, raw.total_count, width_s, period_s, dead_s)
    after, decay_s = constants.afterpulse_probability, constants.afterpulse_decay_s
    whole_period = abs(raw.time.bins * width_s / period_s - 1) < WHOLE_PERIOD
    if after is not None and decay_s is not None and after.value > 0 and whole_period:
        once = slice(min(raw.time.bins, round(period_s / width_s)))  # of a record that is a little longer
        counts[:, once] = subtract_afterpulses(
            counts[:, once], raw.counts[:, once], after.value, decay_s, dead_s, width_s
        )
    return counts, variance


def subtract_dark(
    counts: npt.NDArray[np.generic], raw: RawPoints, constants: BenchConstants | None
) -> npt.NDArray[np.generic]:
    """Counts less the dark counts expected in each bin, where a shutter-closed run of the same length told them."""
    per_bin = constants.dark_per_bin_hz if constants is not None else None
    if per_bin is None or len(per_bin) != raw.time.bins:
        return counts
    return subtract(counts, np.multiply.outer(raw.exposure_s, per_bin))
