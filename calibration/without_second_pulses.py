"""Second pulses taken out: every histogram as if the laser had pulsed once, and nothing had been thrown back.

What is recorded is light and once more, a lag later, a share of it, of each pulse. So the light of each bin is what is
recorded less the shares of the light lags before, from the first bin on: of all pulses at once, for one after the other
would leave the product of their shares. The direct pulse is so much brighter than all else that what
it leaves between two bins would show: it is placed by its own response, and only the rest is shifted.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from nlos.calibration.background import Background
from nlos.calibration.matched_filter import window_counts
from nlos.calibration.second_pulse import SecondPulse

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.float32]
_ROWS = 512
"""So many points at a time."""


def without_second_pulses(
    counts: npt.ArrayLike,
    variance: npt.ArrayLike,
    arrival_bins: Floats,
    background: Background,
    found: Sequence[SecondPulse],
) -> tuple[Counts, Counts]:
    """`counts` and `variance` (N, T) as recorded, less one pulse or more: neither shifted to their direct arrivals
    (N,), NaN where there are none, nor less their `background`."""
    light, spread = np.array(counts, dtype=np.float32), np.array(variance, dtype=np.float32)
    bins, width_s, response = light.shape[1], found[0].bin_width_s, found[0].response
    below = np.where(np.isfinite(background.error), background.per_bin, 0.0)
    direct = np.nan_to_num(window_counts(light, arrival_bins, below, response, width_s))
    first_s = -np.nan_to_num(arrival_bins) * width_s
    lags = [pulse.lag_s / width_s for pulse in found]
    shares = [  # of the light so many bins before, and one
        (int(lag) + more, pulse.share * part)
        for pulse, lag in zip(found, lags, strict=True)
        for more, part in enumerate((1 - lag % 1, lag % 1))
    ]
    nearest = int(min(lags))
    for start in range(0, len(light), _ROWS):
        rows = slice(start, start + _ROWS)
        pulse = direct[rows, None] * response.in_bins(first_s[rows], bins, width_s)
        rest = light[rows] - below[rows, None] - pulse
        for each in found:
            again = response.in_bins(first_s[rows] - each.lag_s, bins, width_s)
            rest -= each.share * direct[rows, None] * again
        for at in range(nearest, bins, nearest):  # the shortest lag at a time: what is before it is done
            for before, share in shares:
                first, end = max(at, before), max(min(at + nearest, bins), before)
                rest[:, first:end] -= share * rest[:, first - before : end - before]
        light[rows] = rest + below[rows, None] + pulse
    once = spread.copy()
    for each, lag in zip(found, lags, strict=True):
        spread[:, round(lag) :] += each.share**2 * once[:, : -round(lag)]
    return light, spread
