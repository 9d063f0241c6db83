"""Lipschitz estimates and convergence curves measure what they say."""

import pytest
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods import faithful
from nlos.recon.methods.nano import Settings, build
from studies.convergence import (
    Contraction,
    Settling,
    contraction,
    lipschitz,
    one_pass,
    passes,
    relative_changes,
    settling,
)

WALL, TIME = WallGrid(2.0, 2.0, 8, 8), TimeAxis(32, 256e-12)


def test_power_iteration_finds_the_norm_of_a_matrix() -> None:
    matrix = torch.diag(torch.tensor([3.0, 1.0, 0.5])) @ torch.linalg.qr(torch.randn(3, 3)).Q
    assert lipschitz(lambda x: matrix @ x, torch.zeros(3), 60) == pytest.approx(3.0, rel=1e-3)


def test_a_sequence_that_halves_its_error_is_told_so() -> None:
    states = [torch.tensor([1.0 + 0.5**k]) for k in range(20)]
    changes = relative_changes(states)
    assert changes[15] - changes[14] == pytest.approx(-0.301, abs=1e-2)


def shell() -> torch.Tensor:
    row, col = torch.meshgrid(torch.arange(8.0), torch.arange(8.0), indexing="ij")
    arrival = 14 + ((row - 4) ** 2 + (col - 4) ** 2) / 8
    rate = 10 * torch.exp(-0.5 * (torch.arange(32.0)[:, None, None] - arrival) ** 2) + 0.1
    return torch.poisson(rate, generator=torch.Generator().manual_seed(1))[None, None]


def test_the_norm_of_a_complex_map_is_that_of_its_pairs_of_real_numbers() -> None:
    matrix = torch.diag(torch.tensor([3j, 1.0, 0.5])).to(torch.complex64)
    assert lipschitz(lambda x: matrix @ x, torch.zeros(3, dtype=torch.complex64), 60) == pytest.approx(3.0, rel=1e-3)


def test_lifting_counts_the_last_volume_alone_so_it_is_0_where_that_comes_in_from_zero() -> None:
    torch.manual_seed(0)
    settings = Settings(weights=None, channels=(4, 6), features=2, spectral_scales=1)
    network = build(settings, WALL, TIME).eval()
    found = contraction(network, shell(), steps=3)
    assert len(found.iterations) == 4
    assert min(found.projection, *found.iterations) > 0
    assert found.lifting == 0
    assert found.product == 0
    assert found.whole_pass == pytest.approx(0.0, abs=1e-6)
    assert len(passes(network, shell(), None, 3)) == 3
    torch.nn.init.normal_(network.unfolding.lift_g.weight, std=0.1)
    assert contraction(network, shell(), steps=3).lifting > 0  # every path of the last volume is seen


def test_every_part_of_the_printed_network_gets_an_estimate() -> None:
    torch.manual_seed(0)
    settings = faithful.Settings(weights=None, channels=(4, 6), sfe_bandwidth=8)
    network = faithful.build(settings, WALL, TIME).eval()
    found = contraction(network, shell(), steps=4)
    assert len(found.iterations) == 4
    assert min(found.lifting, found.projection, found.whole_pass, *found.iterations) > 0
    one = one_pass(network, shell(), None)
    with torch.no_grad():
        torch.testing.assert_close(one.run(one.start), passes(network, shell(), None, 1)[0])


def test_the_product_of_the_theorem_has_one_constant_for_all_iterations() -> None:
    found = Contraction(lifting=2.0, projection=0.5, iterations=(3.0, 1.5, 1.0), whole_pass=1.0, changes=())
    assert found.product == pytest.approx(2.0 * 0.5 * 3.0**3)
    assert found.own_product == pytest.approx(2.0 * 0.5 * 3.0 * 1.5)


def test_whole_passes_are_measured_scan_by_scan() -> None:
    torch.manual_seed(0)
    settings = faithful.Settings(weights=None, channels=(4, 6), sfe_bandwidth=8)
    network = faithful.build(settings, WALL, TIME).eval()
    scans = [{"counts": k * shell(), "exposure": torch.ones(1, 8, 8)} for k in (1, 3)]
    found = settling(network, scans, 4, steps=4)
    assert [len(changes) for changes in found.log10_changes] == [3, 3]
    one = contraction(network, scans[0]["counts"], scans[0]["exposure"], steps=4)
    assert found.whole_passes[0] == pytest.approx(one.whole_pass)
    halving = Settling((1.0,), (tuple(-0.30103 * k for k in range(11)),))
    assert halving.ratios == pytest.approx((0.5,), rel=1e-4)
