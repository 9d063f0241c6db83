"""Light of another program's file that denies what is said of it: told, and not where it agrees."""

import logging

import numpy as np
import pytest

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.array_scan import scan_from_arrays
from nlos.file_doubts import doubt_scale, doubt_wall, tell_of_last_bin

TIME = TimeAxis(512, 16e-12)
SIDE, WALL_M = 16, 1.0


def raw(said_m: float) -> Transient:
    """Direct light of a scanner 0.7 m before a wall of 1 m that is said to be `said_m` wide."""
    at_m = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * WALL_M
    x_m, y_m = np.meshgrid(at_m, -at_m)
    arrives = 2 * np.sqrt((x_m - 0.1) ** 2 + y_m**2 + 0.7**2) / SPEED_OF_LIGHT_M_PER_S / TIME.bin_width_s - 150
    bins = np.arange(TIME.bins)[:, None, None]
    expected = 0.2 + 800 * np.exp(-0.5 * ((bins - arrives) / 2.0) ** 2)
    counts = np.random.default_rng(0).poisson(expected).astype(np.float32)
    return Transient(counts, np.ones((SIDE, SIDE)), WallGrid(said_m, said_m, SIDE, SIDE), TIME)


@pytest.mark.parametrize(("said_m", "doubted"), [(1.0, False), (1.03, False), (1.3, True), (2.0, True), (0.5, True)])
def test_a_wall_that_direct_light_denies_is_doubted(
    said_m: float, doubted: bool, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        doubt_wall("a.npz", raw(said_m))
    assert ("by the times of its direct light it is 1.0" in caplog.text) == doubted


@pytest.mark.parametrize(("late", "told"), [(0, False), (3, False), (30, True), (50_000, True)])
def test_a_last_bin_that_holds_what_came_too_late_is_told(
    late: float, told: bool, caplog: pytest.LogCaptureFixture
) -> None:
    scan = raw(1.0)
    scan.counts[-1] += late / SIDE**2 if late == 3 else late
    with caplog.at_level(logging.WARNING):
        tell_of_last_bin("a.npz", scan)
    assert ("a.npz: the last bin holds" in caplog.text) == told


@pytest.mark.parametrize(("said_m", "asked"), [(1.0, False), (10.0, False), (100.0, True)])
def test_a_wall_in_centimetres_is_asked_about(said_m: float, asked: bool, caplog: pytest.LogCaptureFixture) -> None:
    """16 points a side, and a record that reaches 1.2 m deep."""
    with caplog.at_level(logging.WARNING):
        doubt_scale("a.npz", raw(said_m))
    assert ("is the wall in metres, and the bin width in seconds" in caplog.text) == asked


@pytest.mark.parametrize(
    ("wall", "late", "rectified", "told"),
    [
        (1.0, 0, False, ""),
        (100.0, 0, True, "histograms: points 6.25 m apart"),
        (1.0, 50_000, True, "histograms: the last bin holds"),
        (1.3, 0, False, "histograms: the wall is said to be 1.3 m wide"),
    ],
)
def test_arrays_are_doubted_as_files_are(
    wall: float, late: int, rectified: bool, told: str, caplog: pytest.LogCaptureFixture
) -> None:
    histograms = np.moveaxis(raw(1.0).counts, 0, -1).copy()
    histograms[..., -1] += late
    with caplog.at_level(logging.WARNING):
        scan_from_arrays(histograms, bin_width=TIME.bin_width_s, wall=wall, axes="YXT", rectified=rectified)
    assert told in caplog.text
    assert told or not caplog.text


def test_places_in_centimetres_are_asked_about(caplog: pytest.LogCaptureFixture) -> None:
    histograms = np.moveaxis(raw(1.0).counts, 0, -1).reshape(SIDE**2, -1)
    x_cm, y_cm = (100 * each.ravel() for each in np.meshgrid(*2 * [np.arange(SIDE) / SIDE - 0.5]))
    with caplog.at_level(logging.WARNING):
        scan_from_arrays(histograms, bin_width=TIME.bin_width_s, wall=None, points=(x_cm, y_cm))
    assert "histograms: points" in caplog.text
