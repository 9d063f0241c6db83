"""Coarser and finer grids by keeping or adding frequencies: restriction and prolongation without aliasing."""

import math
from collections.abc import Sequence
from functools import lru_cache

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


def resample_spectrum(spectrum: Tensor, size: Sequence[int]) -> Tensor:
    """(B, C, D, H, W) complex, full FFT with norm "ortho", -> that of the same field on a grid of `size`."""
    factor = 1.0
    for dim, new in zip((2, 3, 4), size, strict=True):
        factor *= (new / spectrum.shape[dim]) ** 0.5
        spectrum = resample_axis(spectrum, new, dim)
    return spectrum * factor


@lru_cache(maxsize=64)
def resampling_matrix(old: int, new: int, device: torch.device) -> Tensor:
    """(new, old) float32: what cutting or padding the spectrum of `old` samples does to them, so no FFT is needed."""
    with torch.inference_mode(False):  # it is kept, and whoever asks next may need gradients
        spectrum = torch.fft.fft(torch.eye(old, dtype=torch.float64), dim=0, norm="forward")
        matrix: Tensor = torch.fft.ifft(resample_axis(spectrum, new, 0), dim=0, norm="forward").real.float()
        return matrix.to(device)


def resample_field(field: Tensor, size: Sequence[int]) -> Tensor:
    """(B, C, D, H, W) real -> the same band-limited field on a grid of `size` over the same extent.

    Constants are kept; so are all frequencies that both grids hold below their Nyquist frequency.
    """
    if tuple(field.shape[2:]) == tuple(size):
        return field
    x = field.permute(0, 2, 3, 4, 1)  # (B, D, H, W, C), contiguous where channels come last in memory
    x = x if torch.is_grad_enabled() else x.float()
    shape = [*x.shape]
    for axis in (1, 2, 3) if size[0] < field.shape[2] else (3, 2, 1):  # most is done where there is least of it
        along = resampling_matrix(shape[axis], size[axis - 1], field.device)
        x = along @ x.reshape(*shape[: axis + 1], math.prod(shape[axis + 1 :]))
        shape[axis] = size[axis - 1]
    return x.reshape(shape).permute(0, 4, 1, 2, 3)
