"""Time axes that hold what they were asked for."""

from types import SimpleNamespace
from typing import cast

import pytest

from nlos.drivers.bench import open_bench
from nlos.drivers.tcspc.axes import part_of_period
from nlos.drivers.tcspc.counter import HistogramAxis, HistogramCounter
from tests.drivers.test_bench import settings


@pytest.mark.parametrize("start_ns", [0.0, 3.3, 7.77, 12.345])
def test_an_axis_begins_no_later_and_ends_no_earlier_than_was_asked_for(start_ns: float) -> None:
    with open_bench(settings()) as bench:
        start_s, end_s = start_ns * 1e-9, start_ns * 1e-9 + 20e-9
        axis = part_of_period(bench.counter, start_s, end_s, 8e-3)
    assert axis.offset_s <= start_s + 1e-15
    assert axis.offset_s + axis.bins * axis.bin_width_s >= end_s - 1e-15
    assert axis.offset_s > start_s - 5e-9


def axis_of(start_ns: float, end_ns: float, most_bins: int) -> HistogramAxis:
    """Of a counter that has every axis."""
    counter = cast(HistogramCounter, SimpleNamespace(check=lambda axis, dwell_s: None))
    return part_of_period(counter, start_ns * 1e-9, end_ns * 1e-9, 8e-3, most_bins)


@pytest.mark.parametrize("start_ns", [*range(0, 200, 7), 31, 62, 124])
def test_whole_nanoseconds_are_taken_as_they_are(start_ns: int) -> None:
    """Although 7e-9 is a little more than 7 times 1e-9, and 31e-9 less: neither a nanosecond nor a bin more."""
    for length_ns in (1, 3, 7):
        axis = axis_of(start_ns, start_ns + length_ns, length_ns * 1000)
        assert (axis.offset_s, axis.bin_width_s) == (pytest.approx(start_ns * 1e-9), 1e-12)
        assert axis.bins == length_ns * 1000


def test_bins_are_as_fine_as_their_number_allows_and_never_too_few() -> None:
    assert axis_of(0.0, 4.0, 3999).bin_width_s == pytest.approx(2e-12)
    assert axis_of(0.5, 4.5, 4500) == HistogramAxis(4500, 1e-12, 0.0)
    assert axis_of(10.0, 10.01, 8192).bins == 64
