"""The way down and up through the scales of a spectrum: what was kept comes back where it was, at every size."""

import itertools

import pytest
import torch

from nlos.recon.layers.complex_convolution import ComplexConv3d, first_kept
from nlos.recon.layers.spectral_scales import AXES, Prolong, Restrict, inserted, shifted, unshifted
from nlos.recon.layers.spectral_unfolding import Readings, SpectralUnfolding

SIZES = range(5, 65)


def identity(layer: ComplexConv3d) -> None:
    """Only the centre tap, and that is 1."""
    with torch.no_grad():
        layer.real.zero_()
        layer.imag.zero_()
        middle = layer.real.shape[-1] // 2
        for channel in range(min(layer.real.shape[:2])):
            layer.real[channel, channel, middle, middle, middle] = 1


def down_and_up(field: torch.Tensor, restriction: str) -> torch.Tensor:
    """A field (D, H, W) through one restriction and one prolongation that change nothing but the frequencies kept."""
    down, up = Restrict(1, 1, restriction), Prolong(1, 1, restriction, "insertion")  # type: ignore[arg-type]
    identity(down.mix)
    identity(up.mix)
    spectrum = shifted(torch.fft.fftn(field[None, None].to(torch.complex64), dim=AXES, norm="ortho"))
    raised = up(down(spectrum), spectrum.shape[2:])
    volume: torch.Tensor = torch.fft.ifftn(unshifted(raised), dim=AXES, norm="ortho")[0, 0]
    assert volume.imag.abs().max() < 1e-4 * volume.real.abs().max() + 1e-6 or restriction == "stride"
    return volume.real


@pytest.mark.parametrize("axis", range(3))
def test_zero_frequency_is_kept_in_the_middle_at_every_size(axis: int) -> None:
    for n in SIZES:
        size = [1, 1, 1]
        size[axis] = n
        spectrum = torch.zeros(1, 1, *size, dtype=torch.complex64)
        centre = [0, 0, 0]
        centre[axis] = n // 2
        spectrum[0, 0, *centre] = 1
        layer = ComplexConv3d(1, 1, 3, stride=2)
        identity(layer)
        coarse = layer(spectrum)
        assert coarse.shape[2 + axis] == len(range(first_kept(n), n, 2))
        assert int(coarse.real.flatten().argmax()) == coarse.shape[2 + axis] // 2, n


@pytest.mark.parametrize("axis", range(3))
def test_every_second_frequency_comes_back_where_it_was(axis: int) -> None:
    layer = ComplexConv3d(1, 1, 3, stride=2)
    identity(layer)
    for n in SIZES:
        size = [2, 3, 2]
        size[axis] = n
        spectrum = torch.complex(torch.randn(1, 1, *size), torch.randn(1, 1, *size))
        coarse = layer(spectrum)
        raised = inserted(coarse, size)
        kept = [slice(first_kept(m), None, 2) for m in size]
        expected = torch.zeros_like(spectrum)
        expected[:, :, *kept] = spectrum[:, :, *kept]
        torch.testing.assert_close(raised, expected)


@pytest.mark.parametrize("axis", range(3))
def test_an_object_returns_at_its_place_and_folded_over_half_the_volume(axis: int) -> None:
    """With every second frequency the volume is the mean of itself and itself moved by half: nothing else moves."""
    for n in [n for n in SIZES if n % 4 == 0]:
        size = [4, 4, 4]
        size[axis] = n
        for place in range(0, n, max(1, n // 5)):
            field = torch.zeros(size)
            where = [1, 1, 1]
            where[axis] = place
            field[*where] = 1
            expected = sum(
                field.roll((dz * size[0] // 2, dy * size[1] // 2, dx * size[2] // 2), (0, 1, 2)) / 8
                for dz, dy, dx in itertools.product((0, 1), repeat=3)
            )
            torch.testing.assert_close(down_and_up(field, "stride"), expected, rtol=1e-4, atol=1e-5)


def test_a_band_limited_object_returns_at_its_place_by_truncation() -> None:
    for n in SIZES:
        z = torch.arange(n) / n
        for place in (0.2, 0.37, 0.8):
            along = 1 + torch.cos(2 * torch.pi * (z - place))
            field = along[:, None, None] * along[None, :, None] * torch.ones(5)
            returned = down_and_up(field, "truncation")
            torch.testing.assert_close(returned, field, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("restriction", ["truncation", "stride"])
def test_restriction_halves_the_frequencies(restriction: str) -> None:
    layer = Restrict(2, 3, restriction)  # type: ignore[arg-type]
    shape = layer(torch.randn(1, 2, 7, 6, 5, dtype=torch.complex64)).shape
    assert shape == ((1, 3, 4, 3, 3) if restriction == "truncation" else (1, 3, 3, 3, 3))


READINGS = [
    {},
    {"sfe_bandwidth": 12},
    {"prolongation": "transposed"},
    {"restriction": "truncation", "whiten": True, "activation": "modrelu"},
    {"lifted": 0, "iterations": 1},
]


def unfolding(**reading: object) -> SpectralUnfolding:
    torch.manual_seed(0)
    sizes = {name: reading.pop(name) for name in ("lifted", "iterations") if name in reading}
    return SpectralUnfolding((4, 6, 8), **sizes, readings=Readings(**reading))  # type: ignore[arg-type]


def fields(size: tuple[int, int, int], lifted: int) -> list[torch.Tensor | None]:
    start, guide = torch.randn(2, 1, *size), torch.randn(2, 1, *size)
    return [start, torch.randn(2, lifted, *size) if lifted else None, guide]


@pytest.mark.parametrize("reading", READINGS)
def test_the_unfolding_keeps_odd_sizes_and_every_part_of_it_is_used(reading: dict[str, object]) -> None:
    network = unfolding(**reading)
    start, lifted, guide = fields((9, 7, 10), int(reading.get("lifted", 4)))  # type: ignore[call-overload]
    assert start is not None
    assert guide is not None
    out = network(start, lifted, guide, torch.randn(2, 1))
    assert out.shape == (2, 1, 9, 7, 10)
    out.square().mean().backward()
    assert all(p.grad is not None and p.grad.abs().max() > 0 for p in network.parameters())


@pytest.mark.parametrize("size", [(8, 8, 8), (9, 7, 10), (20, 5, 6)])
@pytest.mark.parametrize("reading", READINGS)
def test_with_its_steps_at_zero_the_unfolding_returns_what_it_starts_from(
    reading: dict[str, object], size: tuple[int, int, int]
) -> None:
    network = unfolding(**reading)
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            if ".convolution." in name or name.startswith(("prolong.", "aggregate.", "encoded.")):
                parameter.zero_()
    start, lifted, guide = fields(size, int(reading.get("lifted", 4)))  # type: ignore[call-overload]
    assert start is not None
    assert guide is not None
    with torch.no_grad():
        torch.testing.assert_close(network(start, lifted, guide, torch.zeros(2, 1)), start, rtol=1e-3, atol=1e-3)
