"""What `nlos calibrate` prints of numbers that may be read for more than they say."""

import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.calibration.constants import BenchConstants, Quantity
from nlos.calibration.measure import Measurement
from nlos.calibration.raw_points import RawPoints
from nlos.cli.calibration_lines import result_lines


def lines(after: Quantity | None, dead: Quantity) -> str:
    one = np.ones(1)
    raw = RawPoints(np.ones((1, 8)), one, one, 100e-9 * one, one, one, TimeAxis(8, 1e-9))
    found = BenchConstants({}, "2026-01-01", (), 1e-9, ambient_hz=Quantity(900.0, 30.0), dead_time_s=dead,
                           afterpulse_probability=after)  # fmt: skip
    return "\n".join(line for line, _ in result_lines(Measurement(found, raw, None, None), None))


@pytest.mark.parametrize("known", [False, True])
def test_afterpulses_that_were_not_told_apart_are_named(known: bool) -> None:
    said = lines(Quantity(0.01, 1e-4) if known else None, Quantity(77e-9, 1e-11))
    assert ("afterpulses included" in said) is not known


def test_a_dead_time_from_the_histogram_is_told_up_to_whole_periods() -> None:
    assert "or longer by the laser's period of 100 ns" in lines(None, Quantity(50e-9, 1e-11))
    assert "longer" not in lines(None, Quantity(50e-9, 0.0))  # the data sheet's
