"""What `nlos calibrate` prints of numbers that may be read for more than they say."""

import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.calibration.constants import BenchConstants, Quantity
from nlos.calibration.measure import Measurement
from nlos.calibration.raw_points import RawPoints
from nlos.cli.calibration_lines import result_lines
from nlos.cli.exit_codes import UsageError
from nlos.cli.seconds import with_error


def lines(after: Quantity | None, dead: Quantity, measured: bool = False) -> str:
    one = np.ones(1)
    raw = RawPoints(np.ones((1, 8)), one, one, 100e-9 * one, one, one, TimeAxis(8, 1e-9))
    found = BenchConstants({}, "2026-01-01", (), 1e-9, ambient_hz=Quantity(900.0, 30.0), dead_time_s=dead,
                           afterpulse_probability=after)  # fmt: skip
    told = Measurement(found, raw, None, None, dead_time_measured=measured)
    return "\n".join(line for line, _ in result_lines(told, None))


@pytest.mark.parametrize("known", [False, True])
def test_afterpulses_that_were_not_told_apart_are_named(known: bool) -> None:
    said = lines(Quantity(0.01, 1e-4) if known else None, Quantity(77e-9, 1e-11))
    assert ("afterpulses included" in said) is not known


def test_a_dead_time_from_the_histogram_is_told_up_to_whole_periods() -> None:
    assert "or longer by the laser's period of 100 ns" in lines(None, Quantity(50e-9, 1e-11), measured=True)
    assert "longer" not in lines(None, Quantity(50e-9, 3e-10))  # the data sheet's


@pytest.mark.parametrize(
    ("text", "error"),
    [("77", 0.2887), ("77.0", 0.02887), ("77.", 0.2887), ("0", 0.0), ("45+-2.5", 2.5), ("45 ± 3", 3.0), ("45+-0", 0.0)],
)
def test_a_dead_time_by_hand_is_as_good_as_its_last_digit_or_as_it_says(text: str, error: float) -> None:
    value, found = with_error("--dead-time-ns", text)
    assert value == float(text[:2].strip("+"))
    assert found == pytest.approx(error, rel=1e-3)


@pytest.mark.parametrize("text", ["", "-3", "77+", "nan", "inf", "1e3", "77-2", "+-3"])
def test_what_is_no_dead_time_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match=r"--dead-time-ns .*a number is expected, 0 or more"):
        with_error("--dead-time-ns", text)
