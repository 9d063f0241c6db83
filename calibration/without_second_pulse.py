"""A second pulse taken out: every histogram as if the laser had pulsed once, and nothing had been thrown back.

What is recorded is light and once more, a lag later, a share of it. So the light of each bin is what is recorded less
the share of the light a lag before, from the first bin on. The direct pulse is so much brighter than all else that what
it leaves between two bins would show: it is placed by its own response, and only the rest is shifted.
"""

import numpy as np
import numpy.typing as npt

from nlos.calibration.background import Background
from nlos.calibration.matched_filter import window_counts
from nlos.calibration.second_pulse import SecondPulse

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.float32]
_ROWS = 512
"""So many points at a time."""


def without_second_pulse(
    counts: npt.ArrayLike, variance: npt.ArrayLike, arrival_bins: Floats, background: Background, found: SecondPulse
) -> tuple[Counts, Counts]:
    """`counts` and `variance` (N, T) as recorded, less the pulse: neither shifted to their direct arrivals (N,), NaN
    where there are none, nor less their `background`."""
    light, spread = np.array(counts, dtype=np.float32), np.array(variance, dtype=np.float32)
    bins, width_s = light.shape[1], found.bin_width_s
    lag = found.lag_s / width_s
    below = np.where(np.isfinite(background.error), background.per_bin, 0.0)
    direct = np.nan_to_num(window_counts(light, arrival_bins, below, found.response, width_s))
    first_s = -np.nan_to_num(arrival_bins) * width_s
    whole = int(lag)
    shares = found.share * (1 - lag + whole), found.share * (lag - whole)  # of the light so many bins before, and one
    for start in range(0, len(light), _ROWS):
        rows = slice(start, start + _ROWS)
        pulse = direct[rows, None] * found.response.in_bins(first_s[rows], bins, width_s)
        again = direct[rows, None] * found.response.in_bins(first_s[rows] - found.lag_s, bins, width_s)
        rest = light[rows] - below[rows, None] - pulse - found.share * again
        for at in range(whole, bins, whole):  # a lag at a time: what is before it is done
            for before, share in enumerate(shares, whole):
                first, end = max(at, before), min(at + whole, bins)
                rest[:, first:end] -= share * rest[:, first - before : end - before]
        light[rows] = rest + below[rows, None] + pulse
    spread[:, round(lag) :] += found.share**2 * spread[:, : -round(lag)]
    return light, spread
