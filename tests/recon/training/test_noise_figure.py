"""The figure of noise estimation measures what it says, on scenes that no training saw."""

import numpy as np
import pytest

from studies.noise_figure import INSIDE, NoiseFit, held_out


def test_r_squared_is_one_for_the_truth_and_none_for_the_mean() -> None:
    true = np.array([-2.0, -1.0, -0.5])
    assert NoiseFit(true, true).r_squared == 1
    assert NoiseFit(true, np.full(3, true.mean())).r_squared == pytest.approx(0.0)


def test_the_scenes_are_of_kinds_that_no_training_saw() -> None:
    data = held_out(INSIDE, 4)
    assert data.held_out
    assert len(data) == 4
