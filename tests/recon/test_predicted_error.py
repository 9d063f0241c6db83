"""The error of a whole picture as its intervals predict it."""

import numpy as np
import pytest

from nlos.recon.predicted_error import ErrorLine, line_through, relative_error, said_by


def test_intervals_as_wide_as_the_errors_say_the_error_itself() -> None:
    rng = np.random.default_rng(1)
    truth = rng.random((64, 64))
    seen = truth + 0.2 * rng.standard_normal((64, 64))
    scaled = truth * float(np.vdot(seen, seen) / np.vdot(seen, truth))  # the picture at its best scale
    off = np.abs(seen - scaled)
    assert said_by(seen, seen - off, seen + off) == pytest.approx(relative_error(seen, truth), rel=1e-6)
    assert relative_error(7 * seen, truth) == pytest.approx(relative_error(seen, truth))


def test_a_picture_of_nothing_is_wholly_wrong() -> None:
    nothing = np.zeros((8, 8))
    assert relative_error(nothing, np.ones((8, 8))) == 1.0
    assert said_by(nothing, nothing, nothing) == 1.0
    assert said_by(nothing, nothing, nothing + 1) == 1.0


def test_nine_of_ten_errors_stay_below_the_line() -> None:
    rng = np.random.default_rng(2)
    said = rng.uniform(0.05, 0.6, 2000)
    true = 0.8 * said**0.9 * np.exp(rng.normal(0, 0.2, said.size))
    line = line_through(list(said), list(true))
    assert line.slope == pytest.approx(0.9, abs=0.02)
    assert line.above == pytest.approx(1.2816 * 0.2, abs=0.02)
    bounds = [line.at(float(value)) for value in said]
    assert np.mean(true <= bounds) == pytest.approx(0.9, abs=0.01)
    assert ErrorLine(1.0, 1.0, 0.5).at(0.9) == 1.0  # no picture is worse than none
    assert 0 < line.at(0.0) < 0.01
