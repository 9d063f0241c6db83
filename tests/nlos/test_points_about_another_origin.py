"""Points whose places count from another origin than the wall's middle are the same scan, from Python as from files."""

import logging

import numpy as np
import pytest

import nlos
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.array_scan import scan_from_arrays

BIN_S, BINS = 64e-12, 160
X_M, Y_M = (each.ravel() for each in np.meshgrid(0.05 * np.arange(24) - 0.575, 0.475 - 0.05 * np.arange(20)))


def light() -> np.ndarray:
    """(N, T) of a square of 0.2 m at (-0.3, 0.25, 0.8), summed over its points."""
    counts = np.zeros((len(X_M), BINS))
    for to_x_m in -0.3 + 0.01 * np.arange(-9.5, 10):
        for to_y_m in 0.25 + 0.01 * np.arange(-9.5, 10):
            squared = (X_M - to_x_m) ** 2 + (Y_M - to_y_m) ** 2 + 0.64
            arrived = (2 * np.sqrt(squared) / SPEED_OF_LIGHT_M_PER_S / BIN_S).astype(int)
            np.add.at(counts, (np.arange(len(X_M)), arrived), 1 / squared**2)
    return counts


@pytest.mark.parametrize("origin", [(1.0, -0.8), (3.0, -2.0), (0.6, 0.5), (0.575, -0.475)])  # the last two: a corner
def test_points_far_to_one_side_are_taken_about_their_middle(
    origin: tuple[float, float], caplog: pytest.LogCaptureFixture
) -> None:
    counts, places = light(), (X_M + origin[0], Y_M + origin[1])
    with caplog.at_level(logging.WARNING):
        made = nlos.reconstruct(counts, points=places, bin_width=BIN_S)
    assert any("which is taken for the wall's middle" in record.getMessage() for record in caplog.records)
    assert made.albedo.shape == (20, 24)
    row, col = np.unravel_index(made.albedo.argmax(), made.albedo.shape)
    assert made.x_m[col] == pytest.approx(-0.3, abs=0.08)
    assert made.y_m[row] == pytest.approx(0.25, abs=0.08)
    assert made.depth_m[row, col] == pytest.approx(0.8, abs=0.01)


def test_points_of_a_wall_that_is_said_stay_where_they_are() -> None:
    told = scan_from_arrays(light(), bin_width=BIN_S, wall=(9.0, 7.0), points=(X_M + 3, Y_M - 2))
    half = scan_from_arrays(light(), bin_width=BIN_S, wall=None, points=(X_M + 0.6, Y_M))
    assert told.points is not None
    assert half.points is not None
    assert told.points.x_m.max() == pytest.approx(3.575)
    assert half.points.x_m.min() == pytest.approx(0.025)  # which may be half a wall
