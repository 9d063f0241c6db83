"""Glass before the wall, a lens's reflection, bright things behind the corner: photon by photon along their rays."""

import logging

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.calibration.background import before_pulse
from nlos.calibration.constants import BenchConstants
from nlos.calibration.correct import CorrectedPoints, correct_points
from nlos.calibration.measure import ambient_rate
from nlos.calibration.raw_points import RawPoints

C, WIDTH_S, BINS, DELAY_S = 299_792_458.0, 16e-12, 1100, -9e-9
SCANNER_M = np.array([0.1, -0.2, 2.0])
GRID_M = ((np.arange(9) + 0.5) / 9 - 0.5) * 2
X_M, Y_M = (each.ravel() for each in np.meshgrid(GRID_M, -GRID_M))
RAY_M = np.stack([X_M, Y_M, np.zeros(81)], axis=1) - SCANNER_M
WALL_S = DELAY_S + 2 * np.linalg.norm(RAY_M, axis=1) / C
OBJECT_S = 2 * np.sqrt((X_M - 0.2) ** 2 + Y_M**2 + 0.6**2) / C
EVEN, PULSES = 0.05, 1_000_000


def pane_s(before_m: float, lean: float) -> npt.NDArray[np.float64]:
    """When light comes back from a plane that stands `before_m` before the wall's middle and leans by `lean`."""
    normal = np.array([np.sin(lean), 0.0, np.cos(lean)])
    share = ((np.array([0.0, 0.0, before_m]) - SCANNER_M) @ normal) / (RAY_M @ normal)
    return np.asarray(DELAY_S + share * (WALL_S - DELAY_S))


def scan(*light: tuple[npt.NDArray[np.float64], float]) -> RawPoints:
    """Arrivals (81,) with their photons a point, 70 ps wide with a tail of 250 ps, and even light."""
    random = np.random.default_rng(4)
    counts = random.poisson(EVEN, (81, BINS))
    bright = random.uniform(0.6, 1.0, 81)
    for arrival_s, photons in light:
        point = np.repeat(np.arange(81), random.poisson(photons * bright))
        time_s = arrival_s[point] + random.normal(0, 30e-12, len(point))
        time_s += np.where(random.random(len(point)) < 0.05, random.exponential(250e-12, len(point)), 0)
        bins = np.floor(time_s / WIDTH_S).astype(int)
        inside = (bins >= 0) & (bins < BINS)
        np.add.at(counts, (point[inside], bins[inside]), 1)
    one = np.ones(81)
    return RawPoints(
        counts, X_M, Y_M, one * PULSES * 100e-9, one * PULSES, counts.sum(axis=1).astype(float),
        TimeAxis(BINS, WIDTH_S),
    )  # fmt: skip


def off_bins(done: CorrectedPoints) -> float:
    assert done.offsets is not None
    return float(np.abs(done.offsets.offset_bins - WALL_S / WIDTH_S).max())


@pytest.mark.parametrize(("lean", "bright"), [(0.0, 1.0), (0.0, 3.0), (0.15, 1.3)])
def test_time_zero_is_the_walls_behind_a_pane_that_is_as_bright(
    lean: float, bright: float, caplog: pytest.LogCaptureFixture
) -> None:
    raw = scan((WALL_S, 600.0), (pane_s(0.3, lean), 600.0 * bright), (WALL_S + OBJECT_S, 30.0))
    with caplog.at_level(logging.WARNING):
        done = correct_points(raw)
    assert off_bins(done) < 1
    assert "m before the wall (glass?) scatters" in caplog.text


@pytest.mark.parametrize(
    ("hidden_s", "bright"),
    [(np.full(81, 2 * 0.3 / C), 0.5), (2 * (0.5 + 0.3 * X_M) / C, 0.5), (OBJECT_S, 0.5), (OBJECT_S, 1.5)],
)
def test_what_is_bright_behind_the_corner_is_not_taken_for_the_wall(
    hidden_s: npt.NDArray[np.float64], bright: float, caplog: pytest.LogCaptureFixture
) -> None:
    """Planes that return one short pulse, parallel or leaning, and a small object."""
    with caplog.at_level(logging.WARNING):
        done = correct_points(scan((WALL_S, 600.0), (WALL_S + hidden_s, 600.0 * bright)))
    assert off_bins(done) < 1
    assert "before the wall" not in caplog.text


@pytest.mark.parametrize("reflected_s", [np.full(81, WALL_S.min() - 1.2e-9), pane_s(0.3, 0.0)])
@pytest.mark.parametrize("photons", [40.0, 300.0])
def test_what_a_lens_or_a_pane_throws_back_before_the_wall_is_no_ambient_light(
    reflected_s: npt.NDArray[np.float64], photons: float
) -> None:
    """Taken for even light, it is subtracted from every bin of the hidden scene."""
    raw = scan((WALL_S, 600.0), (reflected_s, photons), (WALL_S + OBJECT_S, 30.0))
    done = correct_points(raw)
    assert done.background.per_bin.mean() == pytest.approx(EVEN, abs=0.02)
    assert done.offsets is not None
    ambient = ambient_rate(raw, done.offsets, BenchConstants({}, "2026-01-01", (), WIDTH_S))
    assert ambient is not None
    assert ambient.value == pytest.approx(EVEN / WIDTH_S / PULSES, rel=0.4)


def test_the_level_before_the_pulse_is_that_of_bins_in_which_the_gate_is_open() -> None:
    """Shut for 60 of 200 bins or for 140."""
    for shut in (60, 140):
        counts = np.random.default_rng(1).poisson(np.where(np.arange(400) < shut, 0.0, 2.0), (50, 400))
        found = before_pulse(counts, np.full(50, 200.0))
        assert found.per_bin.mean() == pytest.approx(2.0, rel=0.1)


def test_bins_of_unequal_width_are_no_reflection() -> None:
    """Forty that are 8 % wider, where 100,000 counts tell it beyond doubt."""
    uneven = np.where(np.abs(np.arange(400) - 120) < 20, 6480.0, 6000.0)
    found = before_pulse(np.random.default_rng(1).poisson(uneven, (9, 400)), np.full(9, 315.0))
    assert found.per_bin == pytest.approx(uneven[:315].mean(), rel=0.003)


def test_records_that_hold_nothing_before_their_pulse_tell_no_background() -> None:
    found = before_pulse(np.ones((3, 50)), [0.0, np.nan, -4.0])
    assert found.per_bin.tolist() == [0, 0, 0]
    assert np.isinf(found.error).all()
