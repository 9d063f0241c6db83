"""The part of a time window that light is in: on the light cone, what is near pays for every metre behind it.

Cells of t^2 that are equal over a window of R metres of depth are R^2 / (2 V z) deep at z: a counter that records a
whole laser period of 50 ns (7.5 m) in bins of 32 ps has cells of 3 cm at 0.6 m, where a window of 1.9 m has 0.8 cm.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, Transient

_FEWEST_BINS = 128
_COARSE = 3
"""Bins that a cell may be deep."""
_ROOM = 3 / 4
"""The last quarter of what is kept is dark as well."""
_STANDS_OUT = 4.5
_SHORTEST = 4
"""Bins of the shortest stretch that is looked at."""


def lit_window(transient: Transient, farthest_m: float = 0.0) -> Transient:
    """The transient without the last half of its window, or three quarters, ..., while cells are deeper than `_COARSE`
    bins where light begins, and nothing stands out of the noise there: halves, so that there are few time axes to build
    operators for. It reaches `farthest_m` at least, if it did. Time 0 is at the wall."""
    time, measured = transient.time, transient.exposure_s > 0
    if time.bins < 2 * _FEWEST_BINS or not measured.any():
        return transient
    weight = np.where(measured, 1 / np.maximum(transient.exposure_s, 1e-30), 0.0)
    mean = np.einsum("thw,hw->t", transient.counts, weight, dtype=np.float64) / measured.sum()
    bins, begins = time.bins, time.start_s / time.bin_width_s
    begins += float(np.argmax(mean > 0.1 * mean.max()))
    farthest = (2 * farthest_m / SPEED_OF_LIGHT_M_PER_S - time.start_s) / time.bin_width_s
    fewest = max(_FEWEST_BINS, farthest)
    while bins // 2 >= fewest and bins > 2 * _COARSE * begins and is_dark(mean[int(bins // 2 * _ROOM) :]):
        bins //= 2
    if bins == time.bins or is_dark(mean[:bins]):  # what stands out nowhere may be anywhere
        return transient
    return replace(transient, counts=transient.counts[:bins], time=replace(time, bins=bins))


def is_dark(mean: npt.NDArray[np.floating]) -> bool:
    """Whether no stretch of a mean histogram (T,), short or long, stands out of its median by 4.5 times its noise,
    which the second differences tell."""
    sigma = float(np.sqrt(np.mean(np.diff(mean, 2) ** 2) / 6))
    length = _SHORTEST
    while length <= max(_SHORTEST, len(mean) // 4):
        sums = np.convolve(mean, np.ones(length), mode="valid")
        if (sums - np.median(sums) > _STANDS_OUT * sigma * np.sqrt(length)).any():
            return False
        length *= 2
    return True
