"""The settle model: its measured points, what lies between, and what is no table."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.settle import SettleModel

MODEL = SettleModel()


def optical(mechanical_deg: float) -> float:
    return 2.0 * math.radians(mechanical_deg)


@pytest.mark.parametrize(("step_deg", "settle_ms"), [(0.0, 0.0), (0.1, 0.4), (0.4, 0.4), (20.0, 7.7), (40.0, 20.0)])
def test_the_table_is_met_at_its_points(step_deg: float, settle_ms: float) -> None:
    assert MODEL.axis_settle_s(optical(step_deg)) == pytest.approx(settle_ms * 1e-3)
    assert MODEL.axis_settle_s(-optical(step_deg)) == pytest.approx(settle_ms * 1e-3)


@given(st.floats(0.001, 45), st.floats(0.001, 45))
def test_a_larger_step_is_never_faster(one_deg: float, other_deg: float) -> None:
    small, large = sorted((one_deg, other_deg))
    assert MODEL.axis_settle_s(optical(small)) <= MODEL.axis_settle_s(optical(large)) * (1 + 1e-12)


def test_both_axes_turn_at_once() -> None:
    start, end = MirrorAngles(0.0, 0.1), MirrorAngles(optical(20.0), 0.1 + optical(0.4))
    assert MODEL.settle_s(start, end) == pytest.approx(7.7e-3)


@pytest.mark.parametrize(
    "table", [[(1.0, 1.0)], [(1.0, 1.0), (1.0, 2.0)], [(2.0, 1.0), (1.0, 2.0)], [(1.0, 2.0), (2.0, 1.0)]]
)
def test_a_table_must_rise(table: list[tuple[float, float]]) -> None:
    points = tuple({"step_deg": step, "settle_ms": settle} for step, settle in table)
    with pytest.raises(ValidationError, match="each larger"):
        SettleModel.model_validate({"table": points})


@given(st.lists(st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7)), min_size=2, max_size=40))
def test_many_moves_settle_to_the_last_digit_as_each_of_them(places: list[tuple[float, float]]) -> None:
    x_rad, y_rad = np.array(places).T
    one_by_one = [
        MODEL.settle_s(MirrorAngles(*before), MirrorAngles(*after)) for before, after in itertools.pairwise(places)
    ]
    assert MODEL.settles_s(x_rad, y_rad).tolist() == one_by_one


def test_many_steps_settle_as_lines_on_log_paper_say() -> None:
    table_deg, table_s = np.array([0.4, 20.0, 40.0]), np.array([0.4e-3, 7.7e-3, 20e-3])
    steps_deg = np.concatenate([[0.0, 1e-9, 0.4, 20.0], np.geomspace(0.01, 40.0, 200)])
    drawn_s = np.exp(np.interp(np.log(np.maximum(steps_deg, 1e-30)), np.log(table_deg), np.log(table_s)))
    found_s = MODEL.axis_settles_s(-2.0 * np.radians(steps_deg))
    np.testing.assert_allclose(found_s, np.where(steps_deg == 0, 0.0, drawn_s), rtol=1e-9)
