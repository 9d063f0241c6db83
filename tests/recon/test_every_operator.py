"""Every operator of light transport keeps the same contract: its adjoint is its adjoint, at any size."""

import inspect
import pkgutil
from collections.abc import Callable
from importlib import import_module

import numpy as np
import pytest
import torch
from torch import nn

import nlos.recon.transport
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport.backprojection import BackProjection
from nlos.recon.transport.conventions import Conventions
from nlos.recon.transport.falloff import Falloff
from nlos.recon.transport.fk_migration import FkMigration
from nlos.recon.transport.light_cone import LightConeConvolution
from nlos.recon.transport.phasor_field import ConfocalRsd
from nlos.recon.transport.resampling import LightConeResampling
from nlos.recon.transport.resampling_matrix import resampling_matrix
from nlos.recon.transport.response_bands import bands_of
from nlos.recon.transport.response_on_cone import ResponseOnCone
from nlos.recon.transport.virtual_wave import VirtualWave

GEOMETRIES = {
    "odd": (WallGrid(1.1, 0.7, 5, 7), TimeAxis(19, 200e-12)),
    "one row": (WallGrid(0.9, 0.1, 1, 6), TimeAxis(10, 200e-12)),
    "late start": (WallGrid(0.8, 0.8, 4, 3), TimeAxis(13, 150e-12, 370e-12)),
    "narrow window": (WallGrid(3.0, 3.0, 6, 6), TimeAxis(9, 100e-12)),
    "early start": (WallGrid(0.8, 0.5, 3, 4), TimeAxis(14, 200e-12, -330e-12)),
}


def recorded(time: TimeAxis, conventions: Conventions) -> ResponseOnCone:
    """A lopsided response in three bands."""
    matrix = resampling_matrix(time, conventions)
    taps, cells = np.array([0.0, 0.2, 0.5, 0.2, 0.1]), matrix.shape[0]
    return ResponseOnCone(bands_of(np.ones(time.bins), 3, taps, time, cells, 2 * cells), matrix, 2 * cells)


OPERATORS: dict[str, Callable[[WallGrid, TimeAxis, Conventions], nn.Module]] = {
    "falloff": lambda wall, time, conventions: Falloff(time, 3.0, conventions),
    "resampling": lambda wall, time, conventions: LightConeResampling(time, conventions),
    "light cone": LightConeConvolution,
    "f-k": FkMigration,
    "virtual wave": lambda wall, time, conventions: VirtualWave(time, 0.2, 3.0, conventions),
    "phasor field": lambda wall, time, conventions: ConfocalRsd(wall, time, np.array([0.11, 0.2, 0.34]), 0.2, 3.0),
    "response": lambda wall, time, conventions: recorded(time, conventions),
    "back-projection": lambda wall, time, conventions: BackProjection(wall, time, 0.0, conventions),
    "filtered back-projection": lambda wall, time, conventions: BackProjection(wall, time, 1.3, conventions),
}
ON_CONE = {"light cone", "response"}
COMPLEX = {"f-k", "virtual wave", "phasor field"}


def test_every_operator_of_the_folder_is_tested_here() -> None:
    folder = nlos.recon.transport
    modules = [import_module(f"{folder.__name__}.{info.name}") for info in pkgutil.iter_modules(folder.__path__)]
    linear = {
        kind
        for module in modules
        for _, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, nn.Module) and kind.__module__ == module.__name__
    }
    tested = {type(make(*GEOMETRIES["odd"], "physical")) for make in OPERATORS.values()}
    assert linear == tested


def random(shape: tuple[int, ...], seed: int, kind: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.randn(shape, dtype=kind, generator=torch.Generator().manual_seed(seed))


def dot(a: torch.Tensor, b: torch.Tensor) -> float:
    return float((a.conj() * b).sum().real)


@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize("conventions", ["physical", "authors"])
@pytest.mark.parametrize("name", OPERATORS)
def test_the_adjoint_is_the_adjoint(name: str, conventions: Conventions, geometry: str) -> None:
    wall, time = GEOMETRIES[geometry]
    if conventions == "authors" and time.start_s != 0:
        pytest.skip("the published programs know only time axes that start at 0")
    operator = OPERATORS[name](wall, time, conventions)
    length = operator.cells if name in ON_CONE else time.bins
    x = random((2, 3, length, wall.rows, wall.cols), 1)
    ax = operator(x)
    y = random(tuple(ax.shape), 2, torch.complex128 if name in COMPLEX else torch.float64)
    forward, backward = dot(ax, y), dot(x, operator.adjoint(y))
    scale = float(ax.abs().square().sum().sqrt() * y.abs().square().sum().sqrt())
    assert abs(forward - backward) <= 1e-10 * scale
    assert scale > 0


@pytest.mark.parametrize("name", sorted(OPERATORS))
def test_its_gradient_is_its_adjoint(name: str) -> None:
    wall, time = WallGrid(0.5, 0.4, 3, 2), TimeAxis(8, 200e-12)
    operator = OPERATORS[name](wall, time, "physical")
    x = random((1, 2, 8, 3, 2), 3).requires_grad_()
    assert torch.autograd.gradcheck(operator, (x,), fast_mode=True)
    assert torch.autograd.gradgradcheck(operator, (x,), fast_mode=True)


@pytest.mark.parametrize("name", sorted(OPERATORS))
def test_samples_and_channels_do_not_mix(name: str) -> None:
    wall, time = GEOMETRIES["odd"]
    operator = OPERATORS[name](wall, time, "physical")
    x = random((2, 2, 19, 5, 7), 4)
    whole = operator(x)
    for b in range(2):
        for c in range(2):
            alone = operator(x[b : b + 1, c : c + 1])
            assert torch.allclose(whole[b, c], alone[0, 0], rtol=0, atol=1e-12 * float(whole.abs().max()))


@pytest.mark.parametrize("name", sorted(OPERATORS))
def test_single_precision_agrees_with_double(name: str) -> None:
    wall, time = GEOMETRIES["odd"]
    operator = OPERATORS[name](wall, time, "physical")
    x = random((1, 1, 19, 5, 7), 5)
    double, single = operator(x), operator(x.float())
    assert single.dtype in (torch.float32, torch.complex64)
    assert float((single - double).abs().max()) <= 1e-5 * float(double.abs().max())


def test_the_wiener_inverse_is_differentiable_in_data_and_snr() -> None:
    wall, time = WallGrid(0.5, 0.4, 3, 2), TimeAxis(8, 200e-12)
    cone = LightConeConvolution(wall, time)
    y, snr = random((2, 1, 8, 3, 2), 6).requires_grad_(), torch.tensor([0.3, 2.0], dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(cone.wiener, (y, snr))
    one_by_one = [cone.wiener(y[i : i + 1].detach(), float(snr[i].detach())) for i in range(2)]
    assert torch.allclose(cone.wiener(y, snr), torch.cat(one_by_one))


def test_the_light_cone_is_the_convolution_that_it_claims_to_be() -> None:
    """Against a sum over finely divided wall pixels of delta(v - s - x^2 - y^2), for albedo smooth along s."""
    wall, time = WallGrid(1.0, 0.7, 8, 6), TimeAxis(40, 200e-12)
    cell_m2 = (299_792_458.0 * 40 * 200e-12 / 2) ** 2 / 40
    cells = np.arange(40)
    u = torch.zeros(1, 1, 40, 8, 6, dtype=torch.float64)
    u[0, 0, :, 3, 2] = torch.from_numpy(np.exp(-0.5 * (cells - 10.0) ** 2 / 2.0**2))
    seen = LightConeConvolution(wall, time)(u)[0, 0].numpy()
    fine = (np.arange(24) + 0.5) / 24 - 0.5
    expected = np.zeros_like(seen)
    spread = 2.0**2 + 1 / 6  # albedo and counts are both means over a cell
    for row in range(8):
        for col in range(6):
            y = (row - 3 + fine[:, None]) * wall.height_m / 8
            x = (col - 2 + fine[None, :]) * wall.width_m / 6
            arrival = 10 + (x**2 + y**2) / cell_m2
            expected[:, row, col] = np.exp(-0.5 * (cells[:, None, None] - arrival) ** 2 / spread).mean((1, 2))
    assert np.abs(seen / seen.max() - expected / expected.max()).max() < 0.01


def test_resampling_keeps_the_light() -> None:
    """However the bins fall into cells, their sum stays: each cell collects the integral over its extent."""
    for bins, start_s in ((7, 0.0), (64, 0.0), (50, 333e-12), (33, -100e-12)):
        time = TimeAxis(bins, 100e-12, start_s)
        resample = LightConeResampling(time)
        end = start_s / 100e-12 + bins
        x = random((1, 1, bins, 1, 1), 7)
        share = np.clip(start_s / 100e-12 + np.arange(bins) + 1, 0, 1)  # of a bin at t > 0
        assert float(resample(x).sum()) == pytest.approx(float((x[0, 0, :, 0, 0].numpy() * share).sum()) * 2 / end)


def test_geometry_that_does_not_fit_is_refused_with_both_shapes() -> None:
    wall, time = GEOMETRIES["odd"]
    with pytest.raises(ValueError, match=r"built for 19 x 5 x 7 .* are 19 x 5 x 6"):
        LightConeConvolution(wall, time)(torch.zeros(1, 1, 19, 5, 6))
    with pytest.raises(ValueError, match=r"built for \(19, 5, 7\)"):
        FkMigration(wall, time)(torch.zeros(1, 1, 18, 5, 7))
    with pytest.raises(ValueError, match="snr is 0"):
        LightConeConvolution(wall, time).wiener(torch.zeros(1, 1, 19, 5, 7), 0.0)
