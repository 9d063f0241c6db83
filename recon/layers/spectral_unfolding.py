"""Multi-scale unfolding by small complex kernels over the frequency grid: the literal reading of the paper.

Such a kernel is a window in space and stride 2 over frequencies folds the volume, so this is no filter of physical
frequencies; it is built because the paper's tables are about it.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, cast

import torch
from torch import Tensor, nn

from nlos.recon.layers.complex_activation import ActivationName, complex_activation
from nlos.recon.layers.complex_convolution import ComplexConv3d
from nlos.recon.layers.complex_mlp import ComplexMLP
from nlos.recon.layers.frequency_encoding import StochasticFrequencyEncoding
from nlos.recon.layers.noise_operator import NoiseEmbedding, NoiseInducedOperator
from nlos.recon.layers.spectral_resampling import resample_spectrum

AXES = (2, 3, 4)
Restriction = Literal["truncation", "stride"]


class LiteralIteration(nn.Module):
    """u^ <- u^ + sigma_C(Conv_C(u_g + S_eta u^)), the step size absorbed in the convolution (NANO, eq. 12)."""

    def __init__(self, channels: int, activation: ActivationName):
        super().__init__()
        self.operator = NoiseInducedOperator(channels, activation)
        self.convolution = ComplexConv3d(channels, channels, gain=0.3)
        self.activation = complex_activation(activation, channels)

    def forward(self, u: Tensor, guide: Tensor, lifted: Tensor, embedding: Tensor) -> Tensor:
        out: Tensor = self.activation(self.convolution(guide + self.operator(u, lifted, embedding)))
        return u + out


class Restrict(nn.Module):
    """To half the frequencies: a strided complex convolution (the paper), or truncation and a 1x1x1 one."""

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


def shifted(spectrum: Tensor) -> Tensor:
    """FFT order -> frequency 0 in the middle, so that kernels see neighbouring frequencies side by side."""
    result: Tensor = torch.fft.fftshift(spectrum, dim=AXES)
    return result


def unshifted(spectrum: Tensor) -> Tensor:
    """Back to FFT order."""
    result: Tensor = torch.fft.ifftshift(spectrum, dim=AXES)
    return result


def whitening(size: Sequence[int], device: torch.device) -> Tensor:
    """sqrt(1 + (f / 1.5)^2) on the shifted grid, f in cycles per volume: pictures fall off about as 1 / f."""
    axes = [torch.arange(n, device=device) - n // 2 for n in size]
    z, y, x = torch.meshgrid(*axes, indexing="ij")
    return (1 + (z.square() + y.square() + x.square()) / 1.5**2).sqrt()


class SpectralUnfolding(nn.Module):
    """Phi_eta over J scales of n_j iterations on (u^, F^_st, u_g), skips upwards, SFE below, and B_p (section IV-B2).

    features (B, F, D, H, W) real, eta (B, conditions) -> (B, channels[0], D, H, W) real. u^0, F_st and u_g are lifted
    from the features by real 3x3x3 convolutions; the complex MLP of B_p adds to u^K.
    """

    def __init__(
        self,
        features: int,
        channels: Sequence[int] = (16, 24, 32),
        iterations: int = 2,
        conditions: int = 3,
        activation: ActivationName = "modrelu",
        restriction: Restriction = "truncation",
        whiten: bool = True,
        sfe_bandwidth: int = 0,
    ):
        super().__init__()
        self.whiten = whiten
        self.lift = nn.ModuleList(nn.Conv3d(features, channels[0], 3, padding=1) for _ in range(3))
        self.embeddings = nn.ModuleList(NoiseEmbedding(conditions, width) for width in channels)
        self.iterations = nn.ModuleList(
            nn.ModuleList(LiteralIteration(width, activation) for _ in range(iterations)) for width in channels
        )
        pairs = list(pairwise(channels))
        self.restrict = nn.ModuleList(
            nn.ModuleList(Restrict(fine, coarse, restriction) for _ in range(3)) for fine, coarse in pairs
        )
        self.prolong = nn.ModuleList(ComplexConv3d(coarse, fine, kernel=1, gain=0.5) for fine, coarse in pairs)
        self.aggregate = nn.ModuleList(ComplexConv3d(fine, fine, gain=0.3) for fine, _ in pairs)
        self.sfe = (
            StochasticFrequencyEncoding(channels[-1], sfe_bandwidth, activation=activation) if sfe_bandwidth else None
        )
        self.project = ComplexMLP(channels[0], 2 * channels[0], channels[0], activation, gain=0.3)

    def forward(self, features: Tensor, eta: Tensor) -> Tensor:
        lifted = [layer(features).float() for layer in self.lift]
        with torch.autocast(features.device.type, enabled=False):
            weight = whitening(features.shape[2:], features.device) if self.whiten else torch.ones(1)
            u, f_st, guide = (shifted(torch.fft.fftn(x, dim=AXES, norm="ortho")) * weight for x in lifted)
        outputs: list[Tensor] = []
        for scale, embed in enumerate(self.embeddings):
            if scale:
                layers = cast(nn.ModuleList, self.restrict[scale - 1])
                u, f_st, guide = (layer(x) for layer, x in zip(layers, (u, f_st, guide), strict=True))
            embedding = embed(eta)
            for iteration in cast(nn.ModuleList, self.iterations[scale]):
                u = iteration(u, guide, f_st, embedding)
            outputs.append(u)
        u = outputs.pop()
        if self.sfe is not None:
            u = self.sfe(u)
        for scale in range(len(outputs) - 1, -1, -1):
            fine = outputs[scale]
            raised = shifted(resample_spectrum(unshifted(self.prolong[scale](u)), fine.shape[2:]))
            u = fine + raised + self.aggregate[scale](fine + raised)
        u = u + self.project(u)
        with torch.autocast(features.device.type, enabled=False):
            volume: Tensor = torch.fft.ifftn(unshifted(u / weight), dim=AXES, norm="ortho").real
        return volume
