"""Comparisons say what is told and what is not; a part that is taken out of a network is out of it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods import faithful
from nlos.recon.methods.nano import Nano, Settings, build
from nlos.recon.truth_scenes import Scene
from studies.paired import difference
from studies.results.quality import Quality
from studies.rivals import PAIRS, by_scene, cell
from studies.taken_out import PARTS, PRINTED

WALL, TIME = WallGrid(2.0, 2.0, 16, 16), TimeAxis(64, 128e-12)


def test_a_difference_is_marked_only_where_it_is_told() -> None:
    base = np.array([[20.0, 21.0, 22.0]])
    steady, wild = np.array([[1.0, 1.1, 0.9]]), np.array([[2.0, -1.0, 0.5]])
    assert cell(difference(base + steady, base), "psnr") == "+1.00 ± 0.06 *"
    assert cell(difference(base - steady, base), "psnr") == "-1.00 ± 0.06 worse"
    assert cell(difference(base + wild, base), "psnr") == "+0.50 ± 0.87"
    depth = base / 1000
    assert cell(difference(depth - steady / 1000, depth), "depth_mad_m") == "-1.0 ± 0.1 *"


def test_figures_are_paired_by_scene_and_missing_ones_are_known_to_be() -> None:
    empty = np.zeros((2, 2), np.float32)
    scenes = [Scene(name, Path(name), empty, empty, empty > 0, WALL, None) for name in "abc"]
    figures = {"b": 2.0, "a": None}
    rows = [{"method": "lfe", "condition": "p5", "scene": name, "psnr": value} for name, value in figures.items()]
    found = by_scene(Quality(scenes, rows, {}), "lfe", "p5", "psnr")
    np.testing.assert_array_equal(found, [[np.nan, 2.0, np.nan]])


def test_every_rival_is_compared_with_a_nano_that_saw_as_many_samples() -> None:
    assert {pair.own for pair in PAIRS} == {"nano_4000", "nano_4000_once", "nano_6500"}
    assert all(pair.unequal for pair in PAIRS)


@pytest.fixture
def network() -> Nano:
    """Untrained, with every part that starts from zero made to matter."""
    torch.manual_seed(0)
    made = build(Settings(weights=None, channels=(4, 6, 8), features=3), WALL, TIME).eval()
    with torch.no_grad():
        for parameter in made.parameters():
            if parameter.requires_grad and not parameter.any():
                parameter.normal_(std=0.05)
        made.unfolding.lift_u.weight.normal_(std=0.05)
        for name, parameter in made.unfolding.named_parameters():
            if name.startswith("gains.") or ".head." in name:
                parameter.normal_()
    return made


def changed_by(network: torch.nn.Module, take_out: Callable[..., object]) -> float:
    """Of the picture of a wall seen through noise, with and without a part; both are finite."""
    counts = torch.poisson(torch.full((1, 1, 64, 16, 16), 0.1), generator=torch.Generator().manual_seed(1))
    counts[:, :, 20:23] += 3
    whole = network(counts)[0]
    take_out(network)
    without = network(counts)[0]
    assert torch.isfinite(without).all()
    return float((whole - without).abs().max())


@pytest.mark.parametrize("part", PARTS)
@torch.inference_mode()
def test_a_part_that_is_taken_out_no_longer_matters(network: Nano, part: str) -> None:
    assert changed_by(network, PARTS[part]) > 1e-5


@pytest.mark.parametrize("part", PRINTED)
@torch.inference_mode()
def test_a_part_that_is_taken_out_of_the_printed_network_no_longer_matters(part: str) -> None:
    torch.manual_seed(0)
    settings = faithful.Settings(weights=None, channels=(4, 6, 8), sfe_bandwidth=12)
    printed = faithful.build(settings, WALL, TIME).eval()
    for parameter in printed.parameters():
        if parameter.requires_grad and not parameter.any():
            parameter.normal_(std=0.05)
    assert changed_by(printed, PRINTED[part]) > 1e-7
