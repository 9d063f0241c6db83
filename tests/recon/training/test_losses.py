"""What training minimises: decibels where asked, the same for bright and dim scenes, at the best scale or near it."""

import pytest
import torch

from nlos.recon.method import MethodResult
from nlos.recon.training.losses import LossSettings, best_scale, losses


def batch(level: float, seed: int = 1) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    intensity = level * torch.rand(2, 8, 8, generator=generator)
    return {"intensity": intensity, "depth_m": torch.zeros(2, 8, 8), "coverage": torch.zeros(2, 8, 8)}


def decibels(picture: torch.Tensor, made: dict[str, torch.Tensor]) -> float:
    settings = LossSettings(picture=0.0, log_picture=1.0, depth=0.0)
    return float(losses(MethodResult(picture, torch.zeros(2, 8, 8)), made, settings)["loss"])


def test_halving_the_error_gains_six_decibels_in_every_scene() -> None:
    made = batch(3.0)
    truth = made["intensity"] / made["intensity"].amax(dim=(1, 2), keepdim=True)
    noise = torch.randn(2, 8, 8, generator=torch.Generator().manual_seed(2))
    gain = decibels(truth + 0.4 * noise, made) - decibels(truth + 0.2 * noise, made)
    assert gain == pytest.approx(2 * 0.6931, abs=0.25)


def test_the_best_scale_is_found_and_bounded() -> None:
    truth = torch.rand(1, 8, 8, generator=torch.Generator().manual_seed(3))
    assert float(best_scale(0.5 * truth, truth)) == pytest.approx(2.0, rel=1e-5)
    assert float(best_scale(0.01 * truth, truth)) == 5.0
    assert torch.isfinite(best_scale(torch.zeros(1, 8, 8), truth)).all()


def test_terms_of_weight_zero_are_left_out() -> None:
    made = batch(1.0)
    terms = losses(
        MethodResult(made["intensity"], torch.zeros(2, 8, 8)), made, LossSettings(picture=0.0, log_picture=0.15)
    )
    assert set(terms) == {"log_picture", "depth", "loss"}
