"""The figure of noise estimation measures what it says, on scenes that no training saw."""

import numpy as np
import pytest

from nlos.recon.methods.nano import Settings, build
from studies.noise_figure import INSIDE, KINDS, NoiseFit, estimates, held_out


def test_r_squared_is_one_for_the_truth_and_none_for_the_mean() -> None:
    true = np.array([-2.0, -1.0, -0.5])
    assert NoiseFit(true, true).r_squared == 1
    assert NoiseFit(true, np.full(3, true.mean())).r_squared == pytest.approx(0.0)


def test_the_scenes_are_of_kinds_that_no_training_saw() -> None:
    data = held_out(INSIDE, 4)
    assert data.held_out
    assert len(data) == 4


@pytest.mark.parametrize("kind", KINDS)
def test_drawn_noise_of_every_kind_is_estimated_where_photon_statistics_fail(kind: str) -> None:
    whole = KINDS[kind].model_copy(update={"sparse": 0.0})
    data = held_out(whole, 3).model_copy(update={"rows": 32, "cols": 32})
    ways = estimates(build(Settings(), data.wall, data.time), data, 3)
    error = {way: np.abs(fit.estimated - fit.true) for way, fit in ways.items()}
    assert error["any kind"].max() < 0.12
    if kind == "photons":  # what the operator was trained with stays
        assert np.abs(ways["told"].estimated - ways["photon statistics"].estimated).max() < 0.05
    else:
        assert error["photon statistics"].max() > 1.5 * error["any kind"].max()
        assert error["told"].max() < error["photon statistics"].max()
