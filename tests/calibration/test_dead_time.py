import numpy as np
import numpy.typing as npt
import pytest

from nlos.calibration.constants import Quantity
from nlos.calibration.dead_time import blind_pulses, correct_free_running
from nlos.calibration.errors import InvalidData, SaturatedBins


def photons_per_pulse(bins: int, share: float) -> npt.NDArray[np.float64]:
    """A bright pulse on a background; `share` photons per laser pulse in all."""
    bin_ = np.arange(bins)
    rate = 0.02 / bins + np.exp(-0.5 * ((bin_ - 0.3 * bins) / 3) ** 2)
    return np.asarray(rate * share / rate.sum())


def clicks_in_time_order(rate: npt.NDArray[np.float64], dead_bins: int, pulses: int) -> npt.NDArray[np.int64]:
    """A free-running detector, photon by photon: every photon while blind is missed."""
    random = np.random.default_rng(5)
    bins = len(rate)
    photons = np.repeat(np.arange(bins), random.poisson(rate * pulses))
    times = np.sort(random.integers(0, pulses, len(photons)) * bins + photons)
    clicks, live_from = np.zeros(bins, np.int64), -1
    for t in times.tolist():
        if t >= live_from:
            clicks[t % bins] += 1
            live_from = t + dead_bins
    return clicks


@pytest.mark.parametrize("dead_bins", [70, 170, 430])
def test_a_free_running_detector_is_corrected_to_a_percent(dead_bins: int) -> None:
    """Dead times shorter than, and several times as long as, the laser's period; 20 % of the laser's rate."""
    rate, pulses = photons_per_pulse(200, 0.2), 600_000
    clicks = clicks_in_time_order(rate, dead_bins, pulses)
    photons, variance = correct_free_running(
        clicks[None], [pulses], [clicks.sum()], 1e-9, 200e-9, Quantity(dead_bins * 1e-9, 0.0)
    )
    assert photons.sum() == pytest.approx(rate.sum() * pulses, rel=0.01)
    off = (photons[0] - rate * pulses) / np.sqrt(np.maximum(variance[0], 1))
    assert np.abs(off).max() < 5


def test_a_window_needs_only_the_total_count() -> None:
    rate, pulses = photons_per_pulse(200, 0.2), 400_000
    clicks = clicks_in_time_order(rate, 150, pulses)
    whole, _ = correct_free_running(clicks[None], [pulses], [clicks.sum()], 1e-9, 200e-9, Quantity(150e-9, 0.0))
    window, _ = correct_free_running(clicks[None, :90], [pulses], [clicks.sum()], 1e-9, 200e-9, Quantity(150e-9, 0.0))
    assert window[0].sum() == pytest.approx(whole[0, :90].sum(), rel=0.002)


def test_clicks_beside_the_window_make_the_detector_blind_in_it() -> None:
    """A window at the period's start whose light comes after it: what is blind in it is so by clicks of before."""
    counts, pulses = np.full((1, 20), 50.0), 10_000
    alone, _ = correct_free_running(counts, [pulses], [1000], 1e-9, 100e-9, Quantity(60e-9, 0.0))
    after, _ = correct_free_running(counts, [pulses], [5000], 1e-9, 100e-9, Quantity(60e-9, 0.0))
    assert alone[0, 0] == pytest.approx(-pulses * np.log1p(-50 / pulses))
    # 4000 clicks over 80 ns: 59.5 ns before the window 2975 of them, before its last bin 40.5 ns of them
    # and its own 950; those of the bin itself are in the logarithm.
    live = pulses - np.array([2975, 40.5 * 50 + 950])
    assert after[0, [0, 19]] == pytest.approx(-pulses * np.log1p(-50 / live))


@pytest.mark.parametrize("dead_ns", [30.0, 60.0, 77.0, 100.0, 130.0])
def test_the_edge_of_the_period_is_no_edge_of_the_dead_time(dead_ns: float) -> None:
    """30e-9 / 1e-9 is a little more than 30. What a bin's own clicks do, half a bin on average, is in the logarithm."""
    blind = blind_pulses(np.ones((1, 100)), [100], 1e-9, 100e-9, dead_ns * 1e-9)
    assert blind == pytest.approx(dead_ns - 0.5)


@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("period_s", [200e-9, 199.6e-9])
def test_a_record_longer_than_the_period_is_corrected_as_its_first_period(again: bool, period_s: float) -> None:
    """Whether the counter starts over with each laser pulse, so that later bins stay empty, or lists clicks again."""
    rate, pulses = photons_per_pulse(200, 0.2), 400_000
    clicks = clicks_in_time_order(rate, 150, pulses)
    later = clicks[:90] if again else np.zeros(90, np.int64)
    whole, _ = correct_free_running(clicks[None], [pulses], [clicks.sum()], 1e-9, 200e-9, Quantity(150e-9, 0.0))
    longer = np.concatenate([clicks, later])
    found, variance = correct_free_running(
        longer[None], [pulses], [clicks.sum()], 1e-9, period_s, Quantity(150e-9, 0.0)
    )
    assert found[0, :200] == pytest.approx(whole[0], rel=0.005, abs=2)
    assert found[0, 200:] == pytest.approx(whole[0, :90] if again else 0, rel=0.02, abs=2)
    assert np.isfinite(variance).all()


def test_without_dead_time_nothing_but_the_logarithm_is_left() -> None:
    counts = np.arange(12.0).reshape(2, 6)
    photons, variance = correct_free_running(counts, 1000, [15, 51], 1e-9, 10e-9, Quantity(0.0, 0.0))
    assert np.allclose(photons, -np.log1p(-counts / 1000) * 1000)
    assert np.allclose(variance, counts, rtol=0.03)


@pytest.mark.parametrize("clicks", [40, 41])
def test_as_many_clicks_as_live_pulses_are_refused_by_point_and_bin(clicks: int) -> None:
    counts = np.zeros((3, 8))
    counts[1, 4], counts[1, 6] = 60, clicks
    with pytest.raises(
        SaturatedBins, match=f"point 1, bin 6 clicked {clicks} times, but the detector was live there for only 40"
    ):
        correct_free_running(counts, 100, counts.sum(axis=1), 1e-9, 20e-9, Quantity(3e-9, 0.0))


def test_the_variance_is_that_of_many_measurements() -> None:
    """By drawing: a pulse clicks in a bin or does not, with the probability that its photons give it."""
    rng, pulses, photons = np.random.default_rng(1), 20_000, np.array([0.002, 0.05, 0.4])
    clicks = rng.binomial(pulses, 1 - np.exp(-photons), (4000, 3)).astype(float)
    found, variance = correct_free_running(
        clicks, np.full(4000, pulses), clicks.sum(axis=1), 1e-9, 100e-9, Quantity(0.0, 0.0)
    )
    assert found.mean(axis=0) == pytest.approx(photons * pulses, rel=0.01)
    assert variance.mean(axis=0) == pytest.approx(found.var(axis=0), rel=0.08)


@pytest.mark.parametrize("dead_bins", [60.0, 60.25, 60.5])
def test_bins_in_which_the_dead_time_of_two_photons_a_pulse_ends_are_told(dead_bins: float) -> None:
    """Photon by photon in continuous time. Of photons that come evenly over one bin the first clicks, early in it."""
    random, pulses, bins, even = np.random.default_rng(6), 150_000, 100, 0.02
    number = [random.poisson(2.0 * pulses), random.poisson(even * pulses * bins)]
    within = random.random(sum(number)) * np.repeat([1, bins], number) + np.repeat([10, 0], number)
    times = np.sort(random.integers(0, pulses, len(within)) * float(bins) + within)
    live_again = np.searchsorted(times, times + dead_bins).tolist()
    clicks, at = [], 0
    while at < len(times):
        clicks.append(at)
        at = live_again[at]
    counts = np.bincount((times[clicks] % bins).astype(int), minlength=bins)
    told, variance = correct_free_running(
        counts[None], [pulses], [len(clicks)], 1e-9, 100e-9, Quantity(dead_bins * 1e-9, 0.0)
    )
    assert told[0, 69:73] == pytest.approx(even * pulses, rel=0.12)
    off = (told[0, 20:] - even * pulses) / np.sqrt(variance[0, 20:])
    assert np.abs(off).max() < 4


def test_where_the_dead_time_of_a_bright_pulse_ends_its_error_makes_bins_unknown_and_no_others() -> None:
    """Of two photons a pulse in bin 10, blind for 60 +- 2 bins: the detector comes to life between the starts of bin 68
    and 73, mostly before 72, as the first photon comes early. Half a photon per hundred pulses hides nothing."""
    pulses = 1_000_000
    for photons in (2.0, 0.005):
        counts = np.full((1, 100), 200.0)
        counts[0, 10] = pulses * -np.expm1(-photons)
        _, variance = correct_free_running(counts, [pulses], counts.sum(axis=1), 1e-9, 100e-9, Quantity(60e-9, 2e-9))
        unknown = np.flatnonzero(np.isinf(variance[0])).tolist()
        assert unknown == ([68, 69, 70, 71] if photons > 1 else [])


def test_a_dead_time_told_in_another_unit_is_refused() -> None:
    """77 ns told as 77 us: no pulse was left, and the recorded light was called a closed shutter."""
    counts = np.full((5, 20), 100)  # 2000 clicks in 10 ms: 5 us apart
    correct_free_running(counts, 1e5, 2000, 1e-9, 1e-7, Quantity(77e-9, 1e-9))
    with pytest.raises(InvalidData, match=r"77000 ns cannot be: .* a click comes each 5000 ns. Is it told in nano"):
        correct_free_running(counts, 1e5, 2000, 1e-9, 1e-7, Quantity(77e-6, 1e-6))
