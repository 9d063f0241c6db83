"""Lipschitz estimates and convergence curves measure what they say."""

import pytest
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods.nano import Settings, build
from studies.convergence import contraction, lipschitz, passes, relative_changes

WALL, TIME = WallGrid(2.0, 2.0, 8, 8), TimeAxis(32, 256e-12)


def test_power_iteration_finds_the_norm_of_a_matrix() -> None:
    matrix = torch.diag(torch.tensor([3.0, 1.0, 0.5])) @ torch.linalg.qr(torch.randn(3, 3)).Q
    assert lipschitz(lambda x: matrix @ x, torch.zeros(3), 60) == pytest.approx(3.0, rel=1e-3)


def test_a_sequence_that_halves_its_error_is_told_so() -> None:
    states = [torch.tensor([1.0 + 0.5**k]) for k in range(20)]
    changes = relative_changes(states)
    assert changes[15] - changes[14] == pytest.approx(-0.301, abs=1e-2)


def test_every_part_of_the_operator_gets_an_estimate() -> None:
    torch.manual_seed(0)
    settings = Settings(weights=None, channels=(4, 6), features=2, spectral_scales=1)
    network = build(settings, WALL, TIME).eval()
    row, col = torch.meshgrid(torch.arange(8.0), torch.arange(8.0), indexing="ij")
    arrival = 14 + ((row - 4) ** 2 + (col - 4) ** 2) / 8
    counts = torch.poisson(10 * torch.exp(-0.5 * (torch.arange(32.0)[:, None, None] - arrival) ** 2) + 0.1)[None, None]
    found = contraction(network, counts, steps=3)
    assert len(found.iterations) == 4
    assert min(found.lifting, found.projection, *found.iterations) > 0
    assert found.whole_pass == pytest.approx(0.0, abs=1e-6)  # the last pass comes in from zero
    assert len(passes(network, counts, None, 3)) == 3
