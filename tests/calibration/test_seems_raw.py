"""One pulse at one later time at every point: where it is a question, and where it is none."""

import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.seems_raw import aligned_later_s

BIN_S = 16e-12


def pulses(at: np.ndarray, side_m: float = 1.0, start_s: float = 0.0) -> RawPoints:
    """A pulse of three bins about bin `at` (N,) of each point, on a wall so wide."""
    x_m, y_m = np.random.default_rng(1).uniform(-side_m / 2, side_m / 2, (2, len(at)))
    x_m[:2], y_m[:2] = (-side_m / 2, side_m / 2), (-side_m / 2, side_m / 2)
    counts = np.zeros((len(at), 512))
    for off, height in ((-1, 50.0), (0, 100.0), (1, 50.0)):
        counts[np.arange(len(at)), at + off] = height
    nothing = np.zeros(len(at))
    return RawPoints(counts, x_m, y_m, nothing + 1.0, nothing, nothing, TimeAxis(512, BIN_S, start_s))


@pytest.mark.parametrize(("at", "asked"), [(2, False), (9, False), (10, True), (200, True)])
def test_a_common_pulse_is_later_from_150_ps_on(at: int, asked: bool) -> None:
    found = aligned_later_s(pulses(np.full(40, at), start_s=1e-10))
    assert found == (pytest.approx(1e-10 + at * BIN_S) if asked else None)


@pytest.mark.parametrize(("elsewhere", "asked"), [(3, True), (5, False)])
def test_nine_points_in_ten_have_it_at_one_time(elsewhere: int, asked: bool) -> None:
    at = np.full(40, 60)
    at[1::2] += 1  # a bin more is rounding
    at[:elsewhere] += 30
    assert (aligned_later_s(pulses(at)) is not None) == asked


def test_fewer_than_sixteen_points_say_nothing() -> None:
    assert aligned_later_s(pulses(np.full(16, 60))) is not None
    assert aligned_later_s(pulses(np.full(15, 60))) is None


@pytest.mark.parametrize(("side_m", "start_s", "asked"), [(0.1, 0.0, True), (0.05, 0.0, False), (0.1, 1e-9, False)])
def test_points_that_are_near_each_other_see_all_at_one_time(side_m: float, start_s: float, asked: bool) -> None:
    """19 cm of path and 14 cm between corners: 9.7 bins more for the farther one; 5 cm less wall, or 30 cm more path,
    and it is less than 8."""
    assert (aligned_later_s(pulses(np.full(40, 40), side_m, start_s)) is not None) == asked


def test_light_that_is_no_pulse_is_not_asked_about() -> None:
    raw = pulses(np.full(40, 60))
    raw.counts[:, 100:400] += 2.0  # type: ignore[operator,misc]
    assert aligned_later_s(raw) is None
