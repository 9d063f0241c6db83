"""How noisy counts are that corrections have changed: what was subtracted from them left its noise behind."""

import numpy as np

from nlos.acquisition.transient import Transient
from nlos.recon.explained_parts import CountNoise, photon_unit, photon_unit_of_sums
from nlos.recon.noise import first_lit_bin

MOST_POINTS = 512
FEWEST_BINS = 16


def count_noise(transient: Transient) -> CountNoise:
    """By `photon_unit`; where counts lie below 0, as after calibration, whose photons count 1 at most, by dark bins:
    from second and third differences along time (6 and 20 times the variance, less 8 and 30 times the covariance of
    neighbours). In bright bins light itself bends in time, and would pass for noise."""
    unit = photon_unit(transient)
    measured = transient.exposure_s > 0
    chosen = transient.counts[:, measured]
    if not (chosen < 0).any():
        return CountNoise(unit)
    every = max(1, chosen.shape[1] // MOST_POINTS)
    chosen = chosen[first_lit_bin(chosen[None, None]) :, ::every].astype(np.float64)
    if len(chosen) < FEWEST_BINS:
        return CountNoise(unit)
    second, third = (np.mean(np.diff(chosen, order, axis=0) ** 2, axis=1) for order in (2, 3))
    second = (second[1:] + second[:-1]) / 2  # about the same place as the third
    variance, covariance = (30 * second - 8 * third) / 20, (20 * second - 6 * third) / 20
    mean = np.lib.stride_tricks.sliding_window_view(chosen.mean(axis=1), 4).mean(axis=1)
    dark = mean <= np.median(mean)  # (T - 3,)
    least, there = float(np.median(variance[dark])), float(np.median(mean[dark]))
    beside = min(max(float(np.median(covariance[dark])) / least, 0.0), 0.5) if least > 0 else 0.0
    rise = float(mean.mean()) - there
    slope = (float(variance.mean()) - least) / rise if rise > 0 else 1.0
    photon = min(max(slope, 1e-6), 1 / (1 + 2 * beside))  # a shift by parts of a bin keeps photons
    floor = least - photon * there
    if not floor > 0:
        return CountNoise(unit)
    seconds = float(transient.exposure_s[measured][::every].mean())
    return CountNoise(photon, floor / photon / seconds, beside)


def noise_of_sums(transient: Transient, joined: int) -> CountNoise:
    """The same of so many bins added up."""
    noise = count_noise(transient)
    return noise.of_sums(joined) if noise.level else CountNoise(photon_unit_of_sums(transient, joined))
