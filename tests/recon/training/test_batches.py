"""What becomes of a batch on its way to a step: noise that is new every step, of a stated size."""

import numpy as np
import pytest
import torch

from nlos.recon.training.batches import pooled, with_uniform_noise
from nlos.recon.training.schedule import learning_rate
from nlos.recon.training.train_settings import TrainSettings


def batch() -> dict[str, torch.Tensor]:
    exposure = torch.ones(2, 4, 4)
    exposure[1, ::2] = 0
    exposure[0, 0, 0] = 2
    counts = torch.zeros(2, 1, 200, 4, 4)
    counts[:, :, 50] = 51
    counts = counts * exposure[:, None, None]
    names = ("intensity", "albedo", "coverage", "depth_m", "noise_map")
    flat = {name: torch.ones(2, 4, 4) for name in names}
    return flat | {"counts": counts, "exposure": exposure, "noise_level": torch.ones(2), "background": torch.zeros(2)}


def test_uniform_noise_is_on_the_scale_where_the_brightest_rate_is_255() -> None:
    before = batch()
    after = with_uniform_noise(before, 0.0, 10.0, np.random.default_rng(3))
    level = np.random.default_rng(3).uniform(0, 10, 2) * 51 / 255
    added = after["counts"] - before["counts"]
    assert added[1, :, :, ::2].abs().max() == 0
    for k in range(2):
        noise = (added / before["exposure"][:, None, None].clamp(min=1e-6))[k][:, :, 1::2]
        assert float(noise.min()) >= 0
        assert float(noise.max()) == pytest.approx(level[k], rel=0.02)
        assert float(noise.mean()) == pytest.approx(level[k] / 2, rel=0.05)
        assert float(after["background"][k]) == pytest.approx(level[k] / 2, rel=1e-4)


def test_noise_is_new_every_step_and_the_same_for_the_same_step() -> None:
    one, same, other = (
        with_uniform_noise(batch(), 0.0, 10.0, np.random.default_rng(seed))["counts"] for seed in (1, 1, 2)
    )
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


def test_noise_of_one_strength_is_of_that_strength() -> None:
    before = batch()
    added = with_uniform_noise(before, 10.0, 10.0, np.random.default_rng(5))["counts"] - before["counts"]
    assert float(added[0, :, :, 1:].max()) == pytest.approx(10 * 51 / 255, rel=0.02)
    with pytest.raises(ValueError, match="uniform_noise_least 11 is above uniform_noise_most 10"):
        TrainSettings(method="faithful", uniform_noise_least=11.0, uniform_noise_most=10.0)


def test_what_was_said_about_the_noise_before_is_not_kept() -> None:
    after = with_uniform_noise(batch(), 0.0, 10.0, np.random.default_rng(1))
    assert "noise_level" not in after
    assert "noise_map" not in after
    assert pooled(after)["counts"].shape == (2, 1, 200, 2, 2)


def test_an_exponential_schedule_decays_by_the_same_factor_every_step() -> None:
    settings = TrainSettings(
        method="lfe", samples=100, batch=1, learning_rate=1e-3, last_rate=1e-5, warm_up_steps=0, schedule="exponential"
    )
    rates = np.array([learning_rate(settings, step) for step in range(101)])
    assert rates[0] == pytest.approx(1e-3)
    assert rates[-1] == pytest.approx(1e-5)
    assert np.ptp(rates[1:] / rates[:-1]) < 1e-9
