import numpy as np
import pytest

from nlos.calibration.afterpulsing import from_full_period
from tests.calibration.free_running import PULSES, clicks_of_many

DEAD_S, PROBABILITY, DECAY_S = 40e-9, 0.04, 30e-9


def test_a_histogram_over_the_whole_period_tells_them_too() -> None:
    bins, width, pulses = 1000, 100e-12, 2e8
    dead = 400
    photons = np.full(bins, 2e-6)
    photons[100:105] += 0.03
    detected = photons.copy()
    kernel = np.roll(np.exp(-np.arange(bins) * width / DECAY_S), dead)
    kernel *= PROBABILITY / kernel.sum()
    for _ in range(30):
        after = np.fft.irfft(np.fft.rfft(detected) * np.fft.rfft(kernel), bins)
        preceding = np.array([detected.take(range(b - dead, b), mode="wrap").sum() for b in range(bins)])
        detected = (photons + after) * (1 - preceding)
    counts = np.random.default_rng(0).poisson(detected * pulses)
    quiet = np.arange(bins) > 150
    found = from_full_period(counts, pulses, width, quiet)
    assert abs(found.dead_time_s - DEAD_S) <= 3 * found.dead_time_error_s
    assert abs(found.afterpulse_probability - PROBABILITY) < 3 * found.afterpulse_error
    assert found.decay_s == pytest.approx(DECAY_S, rel=0.1)


@pytest.mark.parametrize(("photons", "probability"), [(1.0, 0.15), (0.1, 0.04), (0.1, 0.0)])
def test_errors_are_the_spread_of_many_histograms(photons: float, probability: float) -> None:
    """Click by click: also of light that leaves the detector live for a part of the pulses, and without afterpulses."""
    off = []
    for seed in range(4):
        counts = clicks_of_many(photons, 1e-3, 40.3, (probability, 30.0), seed)
        found = from_full_period(counts, PULSES, 1e-9, np.arange(100) > 20)
        off.append(
            (
                (found.dead_time_s - 40.3e-9) / found.dead_time_error_s,
                (found.afterpulse_probability - probability) / found.afterpulse_error,
            )
        )
    assert (np.sqrt(np.mean(np.square(off), axis=0)) < 1.8).all()
    assert np.abs(off).max() < 3.5
