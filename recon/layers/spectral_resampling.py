"""Coarser and finer grids by keeping or adding frequencies: restriction and prolongation without aliasing."""

from collections.abc import Sequence

import torch
from torch import Tensor


def resample_axis(spectrum: Tensor, size: int, dim: int) -> Tensor:
    """Cut or zero-pad a full FFT axis to `size` frequencies; the unpaired Nyquist frequency is dropped."""
    old = spectrum.shape[dim]
    kept = (min(old, size) - 1) // 2
    positive = spectrum.narrow(dim, 0, kept + 1)
    negative = spectrum.narrow(dim, old - kept, kept)
    gap = list(spectrum.shape)
    gap[dim] = size - 2 * kept - 1
    return torch.cat((positive, spectrum.new_zeros(gap), negative), dim=dim)


def resample_half_axis(spectrum: Tensor, old: int, size: int) -> Tensor:
    """The same for the last axis of a real FFT of `old` samples: to size // 2 + 1 frequencies."""
    kept = (min(old, size) - 1) // 2
    gap = [*spectrum.shape[:-1], size // 2 - kept]
    return torch.cat((spectrum[..., : kept + 1], spectrum.new_zeros(gap)), dim=-1)


def resample_spectrum(spectrum: Tensor, size: Sequence[int]) -> Tensor:
    """(B, C, D, H, W) complex, full FFT with norm "ortho", -> that of the same field on a grid of `size`."""
    factor = 1.0
    for dim, new in zip((2, 3, 4), size, strict=True):
        factor *= (new / spectrum.shape[dim]) ** 0.5
        spectrum = resample_axis(spectrum, new, dim)
    return spectrum * factor


def resample_field(field: Tensor, size: Sequence[int]) -> Tensor:
    """(B, C, D, H, W) real -> the same band-limited field on a grid of `size` over the same extent; float32.

    Constants are kept; so are all frequencies that both grids hold below their Nyquist frequency.
    """
    if tuple(field.shape[2:]) == tuple(size):
        return field
    with torch.autocast(field.device.type, enabled=False):
        spectrum = torch.fft.rfftn(field.float(), dim=(2, 3, 4), norm="forward")
        spectrum = resample_half_axis(spectrum, field.shape[4], size[2])
        spectrum = resample_axis(resample_axis(spectrum, size[0], 2), size[1], 3)
        resampled: Tensor = torch.fft.irfftn(spectrum, s=tuple(size), dim=(2, 3, 4), norm="forward")
        return resampled
