"""Which points are taken again, how often, and which come last."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.left_to_take import LeftToTake
from nlos.drivers.bench import Bench
from nlos.drivers.errors import DeviceFault
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag

Plans = Callable[..., ScanPlan]
SPOILT = {"SYNC_LOST", "OVERRUN", "TRIGGER_LATE", "TRIGGER_MISSED", "DATA_LOST"}


def left(plan: ScanPlan, said: list[str]) -> LeftToTake:
    bench = SimpleNamespace(
        report=lambda kind, text: said.append(f"{kind}: {text}"),
        mirror=SimpleNamespace(identity=SimpleNamespace(model="galvo")),
    )
    return LeftToTake(plan, cast(Bench, bench), {})


def sample(plan: ScanPlan, number: int, flag: HistogramFlag) -> Sample:
    return Sample(plan[number], Histogram(np.ones(64, np.uint32), 1e-11, 0.0, 0.008, 80_000, 64, flag, 0.0), 0.0)


@pytest.mark.parametrize("flag", [flag for flag in HistogramFlag if flag.value])
def test_a_point_that_is_spoilt_is_taken_three_times_and_then_kept(small_plan: Plans, flag: HistogramFlag) -> None:
    plan, said = small_plan(), []
    todo = left(plan, said)
    again = [todo.is_spoilt(sample(plan, 4, flag)) for _ in range(3)]
    if flag.name in SPOILT:
        assert again == [True, True, False]
        assert said == [f"sample: point 4 is taken again: {flag.name}"] * 2 + [
            f"sample: point 4 is kept as it is after 3 attempts: {flag.name}"
        ]
        assert todo.is_spoilt(sample(plan, 5, flag))
    else:
        assert (again, said) == ([False] * 3, [])


def test_points_that_are_put_off_come_last_those_put_off_twice_after_all(small_plan: Plans) -> None:
    plan = small_plan(2, 3)
    todo = left(plan, [])
    assert [todo.postpone(number) for number in (0, 2, 0)] == [True, True, True]
    assert todo.numbers(9) == [1, 3, 4, 5, 2, 0]
    assert not todo.postpone(0)
    todo.took(sample(plan, 3, HistogramFlag.NONE))
    assert todo.numbers(4) == [1, 4, 5, 2]


def test_a_scan_that_comes_back_to_the_same_point_for_ever_is_ended(small_plan: Plans) -> None:
    todo = left(small_plan(), [])
    for first in (0, 7, 7, 7):
        todo.check_progress(first)
    with pytest.raises(DeviceFault, match="disagreed 3 times from point 7 on"):
        todo.check_progress(7)
    todo.forget_first()
    todo.check_progress(7)
