"""Time axes that hold what they were asked for."""

import pytest

from nlos.drivers.bench import open_bench
from nlos.drivers.tcspc.axes import part_of_period
from tests.drivers.test_bench import settings


@pytest.mark.parametrize("start_ns", [0.0, 3.3, 7.77, 12.345])
def test_an_axis_begins_no_later_and_ends_no_earlier_than_was_asked_for(start_ns: float) -> None:
    with open_bench(settings()) as bench:
        start_s, end_s = start_ns * 1e-9, start_ns * 1e-9 + 20e-9
        axis = part_of_period(bench.counter, start_s, end_s, 8e-3)
    assert axis.offset_s <= start_s + 1e-15
    assert axis.offset_s + axis.bins * axis.bin_width_s >= end_s - 1e-15
    assert axis.offset_s > start_s - 5e-9
