"""A wall that is not plane: its scanner is elsewhere than the errors say, and that is said."""

import numpy as np
import pytest

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S as C
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.measure import Measurement, measure_constants
from nlos.calibration.raw_points import RawPoints

SIDE, BINS, WIDTH_S, SCANNER_M, DELAY_S = 12, 800, 32e-12, np.array([0.25, 0.1, 2.0]), 3e-9


def measured(bulge_m: float, scatter_m: float = 0.0) -> Measurement:
    """Of a wall 1.3 m wide that is `bulge_m` nearer in its middle than at its sides, and rough by `scatter_m`."""
    random = np.random.default_rng(4)
    at = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * 1.3
    x, y = (each.ravel() for each in np.meshgrid(at, at[::-1]))
    wall = np.stack([x, y, bulge_m * (1 - (x / 0.65) ** 2) + random.normal(0, scatter_m, x.shape)], axis=1)
    counts = np.zeros((len(x), BINS), np.uint32)
    for point, place in enumerate(wall):
        time_s = DELAY_S + 2 * np.linalg.norm(SCANNER_M - place) / C + random.normal(0, 34e-12, 2000)
        counts[point] = np.bincount((time_s / WIDTH_S).astype(int), minlength=BINS) + random.poisson(0.05, BINS)
    nothing = np.zeros(len(x))
    raw = RawPoints(counts, x, y, nothing + 1, nothing, nothing, TimeAxis(BINS, WIDTH_S))
    return measure_constants([raw], devices={}, sources=["made"], measured_utc="2026-11-29T00:00:00Z")


@pytest.mark.parametrize("bulge_m", [0.005, 0.02, -0.005])
def test_a_curved_wall_is_said_where_it_moves_the_scanner(bulge_m: float) -> None:
    found = measured(bulge_m)
    (said,) = found.constants.warnings
    assert "curved" in said
    assert "farther off than their errors say" in said
    assert found.constants.arrivals is not None
    assert abs(found.constants.arrivals.scanner_position_m[2] - 2.0) > 0.02


@pytest.mark.parametrize("scatter_m", [0.0, 0.002])
def test_a_plane_or_a_rough_wall_is_not_doubted(scatter_m: float) -> None:
    """Each point off on its own is what the errors are of."""
    assert measured(0.0, scatter_m).constants.warnings == ()
