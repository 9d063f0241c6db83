"""Between the scales of a spectrum: fewer frequencies on the way down, every one back in its place on the way up."""

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor, nn

from nlos.recon.layers.complex_convolution import ComplexConv3d, first_kept
from nlos.recon.layers.spectral_resampling import resample_spectrum

AXES = (2, 3, 4)
Restriction = Literal["truncation", "stride"]
Prolongation = Literal["insertion", "transposed"]


class Restrict(nn.Module):
    """To half the frequencies: every second one by a strided complex convolution (the paper), or the lowest half by
    truncation and a 1x1x1 one. (B, C, D, H, W) complex in the shifted layout, zero frequency at n // 2.
    """

    def __init__(self, channels_in: int, channels_out: int, restriction: Restriction):
        super().__init__()
        self.truncate = restriction == "truncation"
        kernel, stride = (1, 1) if self.truncate else (3, 2)
        self.mix = ComplexConv3d(channels_in, channels_out, kernel, stride)

    def forward(self, spectrum: Tensor) -> Tensor:
        if self.truncate:
            size = [(n + 1) // 2 for n in spectrum.shape[2:]]
            spectrum = shifted(resample_spectrum(unshifted(spectrum), size))
        out: Tensor = self.mix(spectrum)
        return out


class Prolong(nn.Module):
    """Back to `size`: a 1x1x1 complex convolution, then every frequency where the restriction took it from, zeros
    between ("insertion"); "transposed" spreads each over its neighbours by a 3x3x3 one: a transposed convolution.
    """

    def __init__(self, channels_in: int, channels_out: int, restriction: Restriction, prolongation: Prolongation):
        super().__init__()
        self.truncate = restriction == "truncation"
        self.mix = ComplexConv3d(channels_in, channels_out, kernel=1, gain=0.5)
        self.spread: nn.Module = nn.Identity()
        if not self.truncate and prolongation == "transposed":
            self.spread = ComplexConv3d(channels_out, channels_out, gain=1.0)

    def forward(self, spectrum: Tensor, size: Sequence[int]) -> Tensor:
        mixed: Tensor = self.mix(spectrum)
        if self.truncate:
            return shifted(resample_spectrum(unshifted(mixed), size))
        out: Tensor = self.spread(inserted(mixed, size))
        return out


def inserted(spectrum: Tensor, size: Sequence[int]) -> Tensor:
    """Every second frequency of a spectrum of `size`, back in its place, zeros between. Shifted layout."""
    fine = spectrum.new_zeros((*spectrum.shape[:2], *size))
    z, y, x = (slice(first_kept(n), None, 2) for n in size)
    fine[:, :, z, y, x] = spectrum
    return fine


def shifted(spectrum: Tensor) -> Tensor:
    """FFT order -> frequency 0 in the middle, so that kernels see neighbouring frequencies side by side."""
    result: Tensor = torch.fft.fftshift(spectrum, dim=AXES)
    return result


def unshifted(spectrum: Tensor) -> Tensor:
    """Back to FFT order."""
    result: Tensor = torch.fft.ifftshift(spectrum, dim=AXES)
    return result
