"""Every method's code for GPUs, on one that is pretended: no tensor of the CPU meets one of it, and the same picture.
And networks that share nothing: one that moves to another device takes nothing from the next."""

import numpy as np
import pytest
import torch
from torch import nn

from nlos.acquisition.response import gaussian
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.method import MethodResult, takes_response
from nlos.recon.methods import catalogue, find, parse_settings
from nlos.recon.reconstruct import reconstruct
from tests.recon.pretended_gpu import DEVICE, OnGpu, here, pretended_gpu, there

TIME = TimeAxis(128, 128e-12)
POINTS = 24  # from here on NANO's pictures are refined


def network_of(method: str, points: int = POINTS) -> nn.Module:
    """Of what ships, or with weights that nobody trained."""
    torch.manual_seed(0)
    return find(method).build(parse_settings(method, {}), WallGrid(2.0, 2.0, points, points), TIME).eval()


def scan(points: int = POINTS) -> tuple[torch.Tensor, torch.Tensor]:
    """Light of a few surfaces, some points not measured."""
    rng = torch.Generator().manual_seed(1)
    expected = torch.full((1, 1, TIME.bins, points, points), 0.05)
    expected[:, :, 40:44, 5:15, 5:15] += 4.0
    expected[:, :, 60:64, 10:20, 12:22] += 2.0
    exposure = (torch.rand(1, points, points, generator=rng) > 0.2).float()
    return torch.poisson(expected, generator=rng) * exposure[:, None, None], exposure


@torch.no_grad()
def seen(network: nn.Module, counts: torch.Tensor, exposure: torch.Tensor, response: torch.Tensor) -> MethodResult:
    told = (response,) if takes_response(network) else ()
    made: MethodResult[torch.Tensor] = network(counts, exposure, *told)
    return made


@pytest.mark.sampled(3)
@pytest.mark.parametrize("method", sorted(catalogue()))
def test_a_gpu_makes_the_same_picture_and_meets_no_tensor_of_the_cpu(method: str) -> None:
    counts, exposure = scan()
    response = torch.tensor([[0.2, 0.5, 0.3]])
    expected = seen(network_of(method), counts, exposure, response)
    with pretended_gpu() as gpu:
        made = seen(there(network_of(method)), *(OnGpu(x) for x in (counts, exposure, response)))
    assert not gpu.met, f"tensors of the CPU and the GPU met: {gpu.met}"
    assert isinstance(made.albedo, OnGpu), "the picture is brought back by whoever asked for it"
    scale = float(expected.albedo.max())
    torch.testing.assert_close(here(made.albedo), expected.albedo, rtol=0, atol=1e-3 * scale)
    torch.testing.assert_close(here(made.depth_m), expected.depth_m, rtol=0, atol=2e-3, equal_nan=True)


def test_a_picture_by_nano_starts_few_operations() -> None:
    """A GPU waits for each to be started: 12 to 30 microseconds on the machine where it was measured."""
    (counts, _), network = scan(), there(network_of("nano"))
    with pretended_gpu() as gpu:
        network(OnGpu(counts))
    assert gpu.started < 2700  # 2240 about, on 24 x 24 points; 5328 with two mirror images at a time


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ["lct", "nano", "phasor"])
def test_what_it_explains_and_how_sure_it_is_come_back_from_a_gpu(method: str) -> None:
    counts, exposure = scan()
    wall = WallGrid(2.0, 2.0, POINTS, POINTS)
    transient = Transient(
        counts[0, 0].numpy(), exposure[0].double().numpy(), wall, TIME, gaussian(300e-12, "a Gaussian of 300 ps")
    )
    expected = reconstruct(transient, method, {})
    with pretended_gpu() as gpu:
        made = reconstruct(transient, method, {}, DEVICE)
    assert not gpu.met, f"tensors of the CPU and the GPU met: {gpu.met}"
    np.testing.assert_allclose(made.albedo, expected.albedo, rtol=0, atol=1e-3 * float(expected.albedo.max()))
    assert made.explained is not None
    assert expected.explained is not None
    assert made.explained.share == pytest.approx(expected.explained.share, abs=1e-3)
    assert (made.intervals is None) == (expected.intervals is None) == (method != "nano")


@pytest.mark.sampled(3)
@pytest.mark.parametrize("method", sorted(catalogue()))
def test_a_network_that_moves_away_takes_nothing_from_the_next(method: str) -> None:
    counts, exposure = scan()
    with torch.inference_mode():
        before = network_of(method)(counts, exposure).albedo
        stays = network_of(method)
        network_of(method, 2 * POINTS).to("meta")
        torch.testing.assert_close(stays(counts, exposure).albedo, before)
