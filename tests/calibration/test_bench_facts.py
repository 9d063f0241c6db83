"""What of a bench has changed since its constants were measured."""

import pytest

from nlos.calibration.bench_facts import changes


@pytest.mark.parametrize("times", [1.01, 1.001, 1.000001])
def test_a_small_change_is_a_change_and_a_rounding_is_none(times: float) -> None:
    then = {"wall_distance_m": 2.0, "name": "lab", "steps": 3}
    assert changes(then, {**then, "wall_distance_m": 2.0 * times})
    assert not changes(then, {**then, "wall_distance_m": 2.0 * (1 + 1e-12)})
    assert changes(then, {**then, "name": "Lab"})
