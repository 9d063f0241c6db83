"""In bfloat16 a network computes the same to the precision of that, and learns as before."""

import pytest
import torch

from nlos.recon.layers import in_bfloat16 as module
from nlos.recon.layers.in_bfloat16 import bfloat16_is_there, in_bfloat16
from nlos.recon.layers.unet import UNet


@pytest.mark.skipif(not bfloat16_is_there(), reason="this processor has no convolutions in bfloat16")
def test_a_network_in_bfloat16_makes_the_same_to_its_precision_and_learns_in_float32() -> None:
    torch.manual_seed(0)
    network, field = UNet(3, 2, 1, (8, 16)), torch.randn(1, 2, 9, 12, 11)
    with torch.no_grad():
        wanted = network(field)
        in_bfloat16(network)
        made = network(field)
    assert made.dtype == torch.float32
    off = float((made - wanted).norm() / wanted.norm())
    assert 1e-5 < off < 0.02
    learned = network(field)
    assert torch.allclose(learned, wanted, atol=1e-5)
    learned.square().mean().backward()
    assert all(one.grad is not None and one.grad.dtype == torch.float32 for one in network.parameters())


def test_a_processor_without_it_goes_on_in_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "bfloat16_is_there", lambda: False)
    torch.manual_seed(0)
    network, field = UNet(3, 2, 1, (8, 16)), torch.randn(1, 2, 9, 12, 11)
    with torch.no_grad():
        wanted = network(field)
        in_bfloat16(network)
        assert torch.equal(network(field), wanted)
