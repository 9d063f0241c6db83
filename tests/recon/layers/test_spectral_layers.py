"""Multipliers of physical frequency, truncation, random frequencies, and the unfolding built on them."""

import pytest
import torch

from nlos.recon.layers.frequency_encoding import StochasticFrequencyEncoding
from nlos.recon.layers.physical_multiplier import PhysicalMultiplier
from nlos.recon.layers.physical_unfolding import PhysicalUnfolding
from nlos.recon.layers.spectral_resampling import resample_field, resample_spectrum


def wave(size: tuple[int, int, int]) -> torch.Tensor:
    """Two waves that every grid of these tests holds, and a constant."""
    z, y, x = torch.meshgrid(*[torch.arange(n) / n for n in size], indexing="ij")
    return (1.5 + torch.cos(2 * torch.pi * (z + y)) + torch.sin(2 * torch.pi * (x - 2 * z)))[None, None]


@pytest.mark.parametrize("sizes", [((12, 10, 8), (6, 5, 6)), ((11, 9, 7), (16, 12, 10)), ((8, 8, 8), (8, 8, 16))])
def test_a_band_limited_field_is_the_same_on_every_grid(sizes: tuple[tuple[int, int, int], ...]) -> None:
    torch.testing.assert_close(resample_field(wave(sizes[0]), sizes[1]), wave(sizes[1]), rtol=1e-4, atol=1e-4)


def test_a_truncated_spectrum_is_that_of_the_coarser_field() -> None:
    fine = torch.fft.fftn(wave((12, 10, 8)), dim=(2, 3, 4), norm="ortho")
    coarse = torch.fft.fftn(wave((6, 5, 6)), dim=(2, 3, 4), norm="ortho")
    torch.testing.assert_close(resample_spectrum(fine, (6, 5, 6)), coarse, rtol=1e-4, atol=1e-4)


def filtered(field: torch.Tensor, multiplier: PhysicalMultiplier, gains: torch.Tensor) -> torch.Tensor:
    size = tuple(field.shape[2:])
    pitch = (1 / size[0], 1 / size[1], 1 / size[2])
    spectrum = torch.fft.rfftn(field, dim=(2, 3, 4), norm="ortho")
    return torch.fft.irfftn(spectrum * multiplier(gains, size, pitch), s=size, dim=(2, 3, 4), norm="ortho")


def lively_multiplier() -> PhysicalMultiplier:
    multiplier = PhysicalMultiplier(1, start=1.0)
    torch.nn.init.normal_(multiplier.head.weight, std=2.0)
    return multiplier


def test_a_physical_multiplier_filters_alike_on_every_grid() -> None:
    multiplier, gains = lively_multiplier(), torch.tensor([[0.4, -0.7]])
    fine, coarse = (filtered(wave(size), multiplier, gains) for size in ((16, 12, 12), (9, 8, 7)))
    torch.testing.assert_close(resample_field(fine, (9, 8, 7)), coarse, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("dim", [3, 4])
def test_a_physical_multiplier_commutes_with_flips_along_the_wall(dim: int) -> None:
    multiplier, gains = lively_multiplier(), torch.tensor([[0.4, -0.7]])
    field = torch.randn(1, 1, 8, 6, 8)
    expected = filtered(field, multiplier, gains).flip(dim)
    torch.testing.assert_close(filtered(field.flip(dim), multiplier, gains), expected, rtol=1e-3, atol=1e-3)


def test_a_physical_multiplier_answers_to_the_noise() -> None:
    multiplier = lively_multiplier()
    field = torch.randn(1, 1, 8, 8, 8)
    quiet, loud = (filtered(field, multiplier, torch.tensor([[level, 0.0]])) for level in (-1.0, 1.0))
    assert (quiet - loud).abs().max() > 1e-2


def test_frequency_encoding_is_the_same_for_the_same_seed_and_starts_as_identity() -> None:
    u = torch.randn(1, 6, 4, 4, 3, dtype=torch.complex64)
    layers = [StochasticFrequencyEncoding(6, bandwidth=20, rank=4, seed=seed) for seed in (3, 3, 4)]
    assert torch.equal(layers[0].mixing, layers[1].mixing)
    assert not torch.equal(layers[0].mixing, layers[2].mixing)
    torch.testing.assert_close(layers[0](u), u)
    assert torch.linalg.matrix_rank(layers[0].mixing) == 4


def test_low_rank_frequency_encoding_is_a_small_fraction_of_the_full_one() -> None:
    full, low = (StochasticFrequencyEncoding(48, 1024, rank) for rank in (1024, 16))
    count = [sum(p.numel() for p in layer.parameters()) for layer in (full, low)]
    assert count[1] < 0.02 * count[0]


@pytest.mark.parametrize("sfe", [0, 8])
def test_the_physical_unfolding_keeps_odd_sizes_and_every_scale_is_used(sfe: int) -> None:
    network = PhysicalUnfolding(5, channels=(4, 6, 8), sfe_bandwidth=sfe)
    out = network(torch.randn(2, 5, 9, 7, 10), torch.randn(2, 3), (0.02, 0.03, 0.03), torch.rand(2))
    assert out.shape == (2, 4, 9, 7, 10)
    out.square().mean().backward()
    assert all(p.grad is not None for p in network.parameters())


def test_a_field_can_be_resampled_with_gradients_after_an_inference() -> None:
    with torch.inference_mode():
        resample_field(torch.randn(1, 2, 7, 5, 3), (3, 3, 3))
    field = torch.randn(1, 2, 7, 5, 3, requires_grad=True)
    resample_field(field, (3, 3, 3)).sum().backward()
    assert field.grad is not None
