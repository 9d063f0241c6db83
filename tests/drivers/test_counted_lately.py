"""A rate is judged over the newest counts that last as long as a trip asks, of however many histograms."""

import pytest

from nlos.drivers.counted_lately import CountedLately


@pytest.mark.parametrize("dwell_s", [0.2e-3, 1e-3, 4e-3, 9.9e-3])
def test_short_dwells_are_judged_together(dwell_s: float) -> None:
    lately, seen = CountedLately(10e-3), []
    for _ in range(200):
        seen.append(lately.rate_cps(dwell_s, 100e3 * dwell_s))
    first = next(k for k, rate in enumerate(seen) if rate is not None)
    assert first * dwell_s < 10e-3 <= (first + 1) * dwell_s * (1 + 1e-9)
    assert all(rate == pytest.approx(100e3) for rate in seen[first:] if rate is not None)
    assert None not in seen[first:]


def test_a_long_dwell_is_judged_alone() -> None:
    lately = CountedLately(10e-3)
    for _ in range(20):
        lately.rate_cps(1e-3, 0)
    assert lately.rate_cps(10e-3, 1000) == pytest.approx(100e3)
    assert lately.rate_cps(50e-3, 0) == 0


def test_light_that_comes_on_is_seen_within_two_windows_and_old_light_is_forgotten() -> None:
    lately = CountedLately(10e-3)
    for _ in range(100):
        lately.rate_cps(1e-3, 1)
    rates = [lately.rate_cps(1e-3, 100) for _ in range(10)]
    assert rates[-1] == pytest.approx(100e3)
    lately.forget()
    assert lately.rate_cps(1e-3, 1) is None
    assert lately.rate_cps(0.0, 0) is None
