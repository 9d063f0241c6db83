"""What runs on a GPU gives the same results: the tensors' branch of every operator, here on a CPU's tensors."""

import numpy as np
import pytest
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport import fk_migration, fourier, light_cone, phasor_field
from nlos.recon.transport.backprojection import BackProjection
from nlos.recon.transport.conventions import Conventions
from nlos.recon.transport.fk_migration import FkMigration
from nlos.recon.transport.light_cone import LightConeConvolution
from nlos.recon.transport.phasor_field import ConfocalRsd
from nlos.recon.transport.resampling import LightConeResampling

WALL, TIME = WallGrid(1.1, 0.7, 5, 7), TimeAxis(19, 200e-12)
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


@pytest.fixture
def on_tensors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is handed to NumPy."""
    for module in (fourier, light_cone, fk_migration, phasor_field):
        monkeypatch.setattr(module, "array_of", lambda x: x.detach())


@pytest.mark.parametrize("conventions", ["physical", "authors"])
@pytest.mark.parametrize("name", ["light cone", "filtered back-projection", "f-k", "phasor field"])
def test_tensors_give_what_arrays_give(name: str, conventions: Conventions, request: pytest.FixtureRequest) -> None:
    operator = {
        "light cone": lambda: LightConeConvolution(WALL, TIME, conventions, tile=5),
        "filtered back-projection": lambda: BackProjection(WALL, TIME, 1.3, conventions),
        "f-k": lambda: FkMigration(WALL, TIME, conventions),
        "phasor field": lambda: ConfocalRsd(WALL, TIME, np.array([0.11, 0.2, 0.34]), 0.2, 3.0),
    }[name]()
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(2, 2, 19, 5, 7, dtype=torch.float64, generator=generator)
    on_arrays = operator(x)
    y = torch.randn(on_arrays.shape, dtype=on_arrays.dtype, generator=generator)
    back_on_arrays = operator.adjoint(y)
    request.getfixturevalue("on_tensors")
    if name == "phasor field":
        operator._filters = {}
    operator = operator.to(DEVICE)
    assert torch.allclose(operator(x.to(DEVICE)).cpu(), on_arrays, rtol=0, atol=1e-11 * float(on_arrays.abs().max()))
    back = operator.adjoint(y.to(DEVICE)).cpu()
    assert torch.allclose(back, back_on_arrays, rtol=0, atol=1e-11 * float(back_on_arrays.abs().max()))


def test_the_inverses_agree_too(request: pytest.FixtureRequest) -> None:
    cone = LightConeConvolution(WALL, TIME)
    y = torch.randn(2, 1, 19, 5, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    snr = torch.tensor([0.1, 3.0], dtype=torch.float64)
    expected = cone.wiener(y, snr), cone.gram_inverse(y, snr, 0.1)
    request.getfixturevalue("on_tensors")
    cone = cone.to(DEVICE)
    found = cone.wiener(y.to(DEVICE), snr), cone.gram_inverse(y.to(DEVICE), snr, 0.1)
    for a, b in zip(found, expected, strict=True):
        assert torch.allclose(a.cpu(), b, rtol=0, atol=1e-11 * float(b.abs().max()))


@pytest.mark.skipif(DEVICE == "cpu", reason="no GPU: sparse resampling has a branch of its own there")
def test_resampling_on_a_gpu() -> None:
    resample = LightConeResampling(TIME)
    x = torch.randn(2, 2, 19, 5, 7, dtype=torch.float64)
    assert torch.allclose(resample(x.to(DEVICE)).cpu(), resample(x))
    assert torch.allclose(resample.adjoint(x.to(DEVICE)).cpu(), resample.adjoint(x))
