"""The offset map: which residual a place on the wall has."""

import numpy as np
import pytest

from nlos.calibration.arrivals import Arrivals

X_M, Y_M = np.array([0.0005, 0.1, 0.1008, -0.2]), np.array([0.0, 0.1, 0.1, 0.3])
RESIDUAL_S = np.array([1e-11, 2e-11, 3e-11, 4e-11])
MAP = Arrivals(np.array([0.1, -0.2, 2.0]), 1e-9, np.eye(4), 1e-12, X_M, Y_M, RESIDUAL_S)


def residual_s(x_m: float, y_m: float) -> float:
    fitted = 1e-9 + 2 * np.sqrt((x_m - 0.1) ** 2 + (y_m + 0.2) ** 2 + 2.0**2) / 299_792_458
    return float(MAP.at(x_m, y_m) - fitted)


@pytest.mark.parametrize("off_m", [0.0, 1e-12, -1e-12, 4e-4, -4e-4, 9.9e-4, -9.9e-4])
def test_a_place_within_a_millimetre_of_a_point_has_its_residual(off_m: float) -> None:
    """Wherever the point lies: half a millimetre is no border between places."""
    for x_m, y_m in ((X_M[0] + off_m, Y_M[0]), (X_M[0], Y_M[0] + off_m)):
        assert residual_s(x_m, y_m) == pytest.approx(RESIDUAL_S[0], abs=1e-16)
    if abs(off_m) < 9e-4:
        assert residual_s(X_M[3] + off_m / 2**0.5, Y_M[3] + off_m / 2**0.5) == pytest.approx(4e-11, abs=1e-16)


def test_the_nearer_of_two_points_counts_and_farther_places_follow_the_fit() -> None:
    assert residual_s(0.1003, 0.1) == pytest.approx(2e-11, abs=1e-16)
    assert residual_s(0.1005, 0.1) == pytest.approx(3e-11, abs=1e-16)
    for x_m, y_m in ((0.0005 + 1.01e-3, 0.0), (0.0005 + 8e-4, 8e-4), (0.5, 0.5)):
        assert residual_s(x_m, y_m) == pytest.approx(0.0, abs=1e-16)


def test_the_map_has_the_shape_of_what_was_asked_and_no_time_where_no_place_is() -> None:
    at = MAP.at([[0.1, np.nan], [-0.2, 0.7]], [[0.1, 0.0], [0.3, 0.7]])
    assert at.shape == (2, 2)
    assert np.array_equal(np.isnan(at), [[False, True], [False, False]])
