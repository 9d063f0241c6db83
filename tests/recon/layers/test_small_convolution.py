"""Small volumes are convolved by the fast library, and the result is torch's own."""

import pytest
import torch
from torch import nn
from torch.profiler import ProfilerActivity, profile

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.small_convolution import SmallConv3d
from nlos.recon.methods import find, parse_settings


@pytest.mark.parametrize(
    ("shape", "out", "stride", "padding", "bias"),
    [((1, 13, 12, 9, 7), 16, 1, 1, True), ((1, 4, 5, 6, 7), 8, (2, 1, 1), 1, False), ((2, 3, 4, 4, 4), 3, 2, 0, True)],
)
def test_it_is_torchs_own_to_rounding(
    shape: tuple[int, ...], out: int, stride: int | tuple[int, int, int], padding: int, bias: bool
) -> None:
    torch.manual_seed(0)
    small = SmallConv3d(shape[1], out, 3, stride=stride, padding=padding, bias=bias)
    x = torch.randn(shape)
    with torch.inference_mode():
        expected = nn.functional.conv3d(x, small.weight, small.bias, stride, padding)
        assert torch.allclose(small(x), expected, atol=1e-5)
    trained = small(x.requires_grad_())
    assert torch.equal(trained.detach(), expected)
    trained.square().sum().backward()
    assert x.grad is not None
    assert torch.isfinite(x.grad).all()


@pytest.mark.skipif(not torch.backends.mkldnn.is_available(), reason="torch was built without oneDNN")
def test_no_kernel_of_nano_goes_through_the_slow_loop() -> None:
    wall, time = WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 64e-12)
    nano = find("nano").build(parse_settings("nano", {"symmetries": False}), wall, time).eval()
    counts = torch.poisson(torch.full((1, 1, 128, 16, 16), 0.5))
    with torch.inference_mode(), profile(activities=[ProfilerActivity.CPU], record_shapes=True) as seen:
        nano(counts, torch.ones(1, 16, 16))
    slow = [each.input_shapes[1] for each in seen.events() if "slow_conv3d" in each.name and each.input_shapes]
    assert not [kernel for kernel in slow if len(kernel) == 5 and max(kernel[2:]) > 1], slow
