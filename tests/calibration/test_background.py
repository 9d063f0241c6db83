import numpy as np
import pytest

from nlos.calibration.background import before_pulse, dark_rate_per_bin, is_flat, quiet_background, subtract


def test_points_with_one_rate_share_their_estimate() -> None:
    counts = np.random.default_rng(0).poisson(0.02, (400, 100))
    found = before_pulse(counts, np.full(400, 60.0))
    assert np.ptp(found.per_bin) < 0.01
    assert found.per_bin.mean() == pytest.approx(0.02, rel=0.1)


def test_points_with_rates_of_their_own_keep_them() -> None:
    rate = np.linspace(1, 20, 200)
    counts = np.random.default_rng(1).poisson(rate[:, None], (200, 300))
    found = before_pulse(counts, np.full(200, 250.0))
    assert np.abs((found.per_bin - rate) / found.error).max() < 5
    assert np.std((found.per_bin - rate) / found.error) == pytest.approx(1, abs=0.2)


def test_points_that_nothing_tells_apart_have_all_points_error() -> None:
    """Exactly one count a bin, over ten points of 16 bins: 160 counts. The pulse of one comes too early to tell."""
    found = before_pulse(np.ones((11, 40)), np.array([*[16.9] * 10, 7.9]))
    assert found.per_bin == pytest.approx(1.0)
    assert found.error == pytest.approx(np.sqrt(1 / 160))
    assert before_pulse(np.ones((1, 40)), [8.0]).error == pytest.approx(np.sqrt(1 / 8))


def test_without_bins_before_the_pulse_nothing_is_known() -> None:
    found = before_pulse(np.ones((5, 20)), np.array([0, -3, 7, np.nan, 2]))
    assert not found.per_bin.any()
    assert np.isinf(found.error).all()


def test_bright_bins_are_told_from_chance() -> None:
    random = np.random.default_rng(2)
    even, _ = dark_rate_per_bin(random.poisson(0.5, (50, 200)), np.full(50, 0.1))
    assert even.std() < 0.1 * even.mean()
    rate = np.full(200, 0.5)
    rate[40] = 5.0
    hot, error = dark_rate_per_bin(random.poisson(rate, (50, 200)), np.full(50, 0.1))
    assert abs(hot[40] - 50) < 4 * error[40]


def test_a_rate_in_the_dark_is_off_by_as_much_as_its_error_says() -> None:
    rate_hz = np.linspace(10, 300, 400)
    found_hz, error_hz = dark_rate_per_bin(np.random.default_rng(6).poisson(rate_hz * 0.1, (50, 400)), np.full(50, 0.1))
    assert np.std((found_hz - rate_hz) / error_hz) == pytest.approx(1.0, abs=0.15)


def test_subtraction_keeps_the_mean_and_does_not_clip() -> None:
    counts = np.random.default_rng(3).poisson(0.3, (50, 500))
    left = subtract(counts, np.full(50, 0.3))
    assert abs(left.mean()) < 0.02
    assert left.min() < 0


def test_only_steady_counts_are_flat() -> None:
    random = np.random.default_rng(4)
    assert is_flat(random.poisson(0.1, (100, 512)))
    lit = random.poisson(0.1, (100, 512))
    lit[:, 200] += random.poisson(3.0, 100)
    assert not is_flat(lit)
    assert quiet_background(lit).mean() == pytest.approx(0.1, rel=0.2)


def test_a_little_light_is_not_flat_and_much_light_is_no_background() -> None:
    random = np.random.default_rng(7)
    little, much = random.poisson(0.1, (2, 100, 512))
    little[:, 205] += random.poisson(1.6, 100)  # as many as the background of its 16 bins, 13 times their noise
    much[:, 205] += 200
    assert not is_flat(little)
    assert quiet_background(much).mean() == pytest.approx(0.1, rel=0.2)


@pytest.mark.parametrize("per_bin", [0.003, 0.05, 2.0])
def test_the_background_of_few_counts_is_the_mean_of_its_posterior(per_bin: float) -> None:
    """Rates spread as exp(-rate / mean): by drawing, points of a given count have had this rate on average."""
    random = np.random.default_rng(8)
    rates = random.exponential(per_bin, 20_000)
    told = quiet_background(random.poisson(rates[:, None], (20_000, 64)))
    counts = told.argsort()
    for some in np.array_split(counts, 4):  # faint to bright
        assert told[some].mean() == pytest.approx(rates[some].mean(), rel=0.1)
