"""Gradients in bfloat16 of convolutions over few planes are those of float32."""

import pytest
import torch
from torch import Tensor, nn

from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.network import build, objective
from nlos.recon.training.shallow_convolutions import ShallowInFloat32
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.training_sample import collate


def gradient(layer: nn.Conv3d, volume: Tensor, bfloat16: bool) -> Tensor:
    layer.zero_grad()
    used = [torch.full((1 << 20,), torch.nan) for _ in range(8)]  # what memory may hold before
    del used
    with torch.autocast("cpu", torch.bfloat16, enabled=bfloat16), ShallowInFloat32():
        out = layer(volume)
    out.float().square().mean().backward()  # type: ignore[no-untyped-call]
    assert layer.weight.grad is not None
    return layer.weight.grad.clone()


@pytest.mark.parametrize("shape", [(1, 9, 9), (2, 9, 9), (3, 9, 9), (4, 9, 9), (5, 9, 9), (8, 1, 9)])
@pytest.mark.parametrize("kernel", [3, 5])
def test_gradients_of_shallow_volumes_are_those_of_float32(kernel: int, shape: tuple[int, ...]) -> None:
    torch.manual_seed(0)
    layer, volume = nn.Conv3d(32, 32, kernel, padding=kernel // 2), torch.randn(1, 32, *shape)
    wanted = gradient(layer, volume, bfloat16=False)
    assert gradient(layer, volume, bfloat16=True) == pytest.approx(wanted, abs=0.05 * float(wanted.abs().max()))


def test_deep_volumes_stay_in_bfloat16() -> None:
    layer, volume = nn.Conv3d(4, 4, 3, padding=1), torch.randn(1, 4, 8, 8, 8)
    with torch.autocast("cpu", torch.bfloat16), ShallowInFloat32():
        assert layer(volume).dtype == torch.bfloat16
        assert layer(volume[:, :, :2]).dtype == torch.float32


def test_nlost_learns_from_short_scans() -> None:
    """It joins planes, so that its kernels of five see three of them."""
    data = DatasetSettings(rows=32, cols=32, bins=128, bin_width_ps=128.0, scenes=1, degradations=1)
    settings = TrainSettings(
        method="nlost", method_settings={"farthest": 0.9}, data=data, validation=data, batch=1, precision="bf16"
    )
    torch.manual_seed(1)
    network = build(settings, data.wall, data.time)
    objective(network, collate([sample(data, 0)]), settings, "cpu")["loss"].backward()  # type: ignore[no-untyped-call]
    assert all(bool(p.grad.isfinite().all()) for p in network.parameters() if p.grad is not None)
