"""A laser that pulses twice, photon by photon, beside hidden surfaces that come nearly as one pulse to every point."""

import logging

import numpy as np
import pytest

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S as C
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.correct import correct_points
from nlos.calibration.raw_points import RawPoints

SIDE, BINS, WIDTH_S, DIRECT, HIDDEN = 14, 900, 32e-12, 2000, 300
SCANNER_M = np.array([0.25, 0.1, 2.0])


def scan(wall_m: float, patch_m: tuple[float, float], second: tuple[float, float]) -> RawPoints:
    """A square wall, a square patch before it at `patch_m` (depth, side), and of every photon a share `second[1]` more,
    `second[0]` seconds later; 80 ps FWHM."""
    random = np.random.default_rng(3)
    at = (np.arange(SIDE) + 0.5) / SIDE * wall_m - wall_m / 2
    x, y = (each.ravel() for each in np.meshgrid(at, at[::-1]))
    wall = np.stack([x, y, 0 * x], axis=1)
    counts = np.zeros((len(x), BINS), np.uint32)
    for point, place in enumerate(wall):
        seen, direct = random.poisson([HIDDEN, DIRECT * (0.5 + random.random())])
        hit = np.stack([*random.uniform(-0.5, 0.5, (2, seen)) * patch_m[1], np.full(seen, patch_m[0])], axis=1)
        way_m = np.concatenate([np.zeros(direct), np.linalg.norm(hit - place, axis=1)])
        times = 3e-9 + 2 * (np.linalg.norm(SCANNER_M - place) + way_m) / C
        times = np.concatenate([times, times[random.random(len(times)) < second[1]] + second[0]])
        bins = np.floor((times + random.normal(0, 34e-12, len(times))) / WIDTH_S).astype(int)
        counts[point] = np.bincount(bins[bins < BINS], minlength=BINS) + random.poisson(0.02, BINS)
    nothing = np.zeros(len(x))
    return RawPoints(counts, x, y, nothing + 1, nothing, nothing, TimeAxis(BINS, WIDTH_S))


@pytest.mark.parametrize(("lag_ns", "percent"), [(1.0, 10), (2.0, 1), (5.0, 20)])
def test_a_second_pulse_is_told_with_its_lag_and_its_brightness(
    lag_ns: float, percent: float, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        correct_points(scan(1.0, (0.7, 0.3), (lag_ns * 1e-9, percent / 100)))
    assert "pulses twice" in caplog.text
    words = caplog.text.split()
    assert float(words[words.index("comes") + 1]) == pytest.approx(lag_ns, abs=0.02)
    assert float(words[words.index("%") - 1]) == pytest.approx(percent, rel=0.07)


@pytest.mark.parametrize(
    ("wall_m", "patch_m"),
    [(1.0, (0.7, 0.3)), (1.0, (0.3, 1.2)), (0.3, (1.0, 0.1)), (0.3, (0.8, 0.2)), (0.3, (1.5, 0.4))],
)
def test_a_surface_is_no_second_pulse_however_far_or_even_it_is(
    wall_m: float, patch_m: tuple[float, float], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        correct_points(scan(wall_m, patch_m, (0.0, 0.0)))
    assert "second pulse" not in caplog.text
