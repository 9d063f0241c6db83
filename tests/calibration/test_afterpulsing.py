import numpy as np
import pytest

from calibration.afterpulsing import from_arrival_times, from_full_period, subtract_afterpulses
from calibration.errors import InvalidData

DEAD_S, PROBABILITY, DECAY_S = 40e-9, 0.04, 30e-9


def steady_light(seed: int = 2, rate_hz: float = 5e5, seconds: float = 0.4) -> np.ndarray:
    random = np.random.default_rng(seed)
    photons = np.cumsum(random.exponential(1 / rate_hz, int(rate_hz * seconds))).tolist()
    clicks, pending, live_from = [], [], -1.0
    for photon in photons:
        while pending and pending[0] < photon:
            again = pending.pop(0)
            if again >= live_from:
                clicks.append(again)
                live_from = again + DEAD_S
                if random.random() < PROBABILITY:
                    pending.append(live_from + random.exponential(DECAY_S))
        if photon >= live_from:
            clicks.append(photon)
            live_from = photon + DEAD_S
            if random.random() < PROBABILITY:
                pending.append(live_from + random.exponential(DECAY_S))
    return np.array(clicks)


def test_time_tags_tell_dead_time_and_afterpulsing() -> None:
    found = from_arrival_times(steady_light())
    assert abs(found.dead_time_s - DEAD_S) < 1e-9
    assert abs(found.afterpulse_probability - PROBABILITY) < 3 * found.afterpulse_error + 0.002
    assert found.decay_s == pytest.approx(DECAY_S, rel=0.25)


def test_a_histogram_over_the_whole_period_tells_them_too() -> None:
    bins, width, pulses = 1000, 100e-12, 2e8
    dead = 400
    seen = np.full(bins, 2e-6)
    seen[100:105] += 0.03
    detected = seen.copy()
    kernel = np.roll(np.exp(-np.arange(bins) * width / DECAY_S), dead)
    kernel *= PROBABILITY / kernel.sum()
    for _ in range(30):
        after = np.fft.irfft(np.fft.rfft(detected) * np.fft.rfft(kernel), bins)
        preceding = np.array([detected.take(range(b - dead, b), mode="wrap").sum() for b in range(bins)])
        detected = (seen + after) * (1 - preceding)
    counts = np.random.default_rng(0).poisson(detected * pulses)
    quiet = np.ones(bins, bool)
    quiet[95:115] = False
    found = from_full_period(
        counts, pulses, width, quiet, np.arange(36e-9, 44e-9, 0.1e-9), np.arange(10e-9, 60e-9, 5e-9)
    )
    assert abs(found.dead_time_s - DEAD_S) <= max(3 * found.dead_time_error_s, 0.1e-9)
    assert abs(found.afterpulse_probability - PROBABILITY) < 4 * found.afterpulse_error + 0.001
    cleaned = subtract_afterpulses(detected[None], PROBABILITY, DECAY_S, DEAD_S, width)
    assert np.allclose(
        cleaned[0], detected - np.fft.irfft(np.fft.rfft(detected) * np.fft.rfft(kernel), bins), rtol=1e-3, atol=1e-9
    )


def test_few_intervals_are_refused() -> None:
    with pytest.raises(InvalidData, match="at least 1000"):
        from_arrival_times(np.arange(10.0))
