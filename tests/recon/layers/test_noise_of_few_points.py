"""Coarse scans have networks of their own that say how noisy they are; scans with gaps are no coarse ones."""

import math

import pytest
import torch

from nlos.recon.any_noise import any_noise_for
from nlos.recon.layers.any_noise import INPUTS, OWN, PEAK, POINTS, AnyNoise
from studies.noise_figure import KINDS, SHOWN, estimates, held_out, with_noise_estimation


def by(network: AnyNoise, points: int, kept: float) -> float:
    """What the networks add to a scan of so many points whose other traits are nothing."""
    traits = torch.zeros(1, INPUTS)
    traits[0, POINTS] = math.log10(points)
    return float((network(traits, torch.tensor([kept])) - traits[0, 0] + traits[0, OWN + PEAK])[0])


def test_few_points_of_a_whole_grid_alone_are_corrected_by_networks_of_their_own() -> None:
    network = AnyNoise()
    for members, bias in ((network.corrections, 1.0), (network.middle, 2.0), (network.few, 4.0)):
        for member in members:
            torch.nn.init.constant_(member[-1].bias, bias)  # type: ignore[index]
    with torch.no_grad():
        assert by(network, 64, 1.0) == by(network, 256, 1.0) == 4.0
        assert 1.0 < by(network, 450, 1.0) < 4.0
        assert by(network, 1024, 1.0) == by(network, 1600, 1.0) == 2.0
        assert 1.0 < by(network, 880, 1.0) < 2.0
        assert 1.0 < by(network, 2000, 1.0) < 2.0
        for points, kept in ((760, 1.0), (2304, 1.0), (4096, 1.0), (64, 0.06), (1024, 0.25)):
            assert by(network, points, kept) == pytest.approx(1.0)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("side", [28, 32, 36, 40])
@pytest.mark.parametrize("kind", list(KINDS))
def test_what_ships_tells_the_noise_of_about_a_thousand_points_of_scenes_of_other_kinds(kind: str, side: int) -> None:
    """Between the grids that its networks have learned from, too."""
    detector = KINDS[kind].model_copy(update={"sparse": 0.0})
    data = held_out(detector, 24).model_copy(update={"rows": side, "cols": side, "seed": 83})
    fit = estimates(with_noise_estimation(None, data), data, 24)[SHOWN]
    assert fit.r_squared > 0.85
    assert abs(fit.bias) < 0.06


@pytest.mark.parametrize("kind", ["photons", "uniform"])
def test_what_ships_is_right_in_the_mean_on_64_points_of_scenes_of_other_kinds(kind: str) -> None:
    """Against the noise that was drawn; without these networks it is 0.2 and 0.3 decades too high."""
    assert any_noise_for("nano") is not None
    detector = KINDS[kind].model_copy(update={"sparse": 0.0})
    data = held_out(detector, 16).model_copy(update={"rows": 8, "cols": 8})
    fit = estimates(with_noise_estimation(None, data), data, 16)[SHOWN]
    assert abs(fit.bias) < 0.15
