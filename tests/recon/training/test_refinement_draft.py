"""Fits in several folders, and how much of what they change in brightness is shipped."""

from pathlib import Path

import pytest
import torch

from nlos.recon.layers.light_left_over import CHANNELS
from nlos.recon.layers.refinement import ALBEDO, CHANGE, Correction
from nlos.recon.training.refinement import DRAFT, draft
from nlos.recon.weights.files import save

SIDE = 16


def fitted(folder: Path, seed: int) -> Path:
    """A network that says something, as a fit leaves it."""
    torch.manual_seed(seed)
    made = Correction()
    torch.nn.init.normal_(made.network.head.weight, std=1e-3)
    torch.nn.init.normal_(made.network.head.bias, std=1e-3)  # type: ignore[arg-type]
    folder.mkdir()
    save(folder / DRAFT, made.state_dict(), {"method": "refinement of nano"})
    return folder


@torch.no_grad()
def test_a_share_of_the_change_in_brightness_is_taken_and_depth_is_left(tmp_path: Path) -> None:
    folder = fitted(tmp_path / "a", 1)
    found = torch.randn(1, len(CHANNELS), SIDE, SIDE)
    found[:, ALBEDO] = 0.5
    found[0, ALBEDO, ::2, ::2] = 1.0  # nothing outshines its surroundings
    found[:, CHANGE] = 0.01
    whole, deeper = draft([folder])(found)
    part, as_deep = draft([folder], 0.8)(found)
    dark = found[:, ALBEDO] == 0.5
    change = (whole - found[:, ALBEDO])[dark]
    assert change.abs().max() > 1e-4
    assert (part - found[:, ALBEDO])[dark] == pytest.approx(0.8 * change, abs=1e-6)
    assert torch.equal(deeper, as_deep)
    assert deeper.any()


def test_of_several_fits_the_mean_of_the_weights_is_taken(tmp_path: Path) -> None:
    one, other = fitted(tmp_path / "a", 1), fitted(tmp_path / "b", 2)
    alone = [draft([folder]).state_dict() for folder in (one, other)]
    for name, weights in draft([one, other]).state_dict().items():
        assert torch.allclose(weights, (alone[0][name] + alone[1][name]) / 2, atol=1e-7), name
