"""Multi-scale unfolding of the gradient flow with multipliers of physical frequency: the operator that ships."""

from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn

from nlos.recon.layers.frequency_encoding import StochasticFrequencyEncoding
from nlos.recon.layers.physical_multiplier import PhysicalMultiplier
from nlos.recon.layers.residual_block import ResidualBlock
from nlos.recon.layers.response_condition import ResponseCondition
from nlos.recon.layers.small_convolution import SmallConv3d
from nlos.recon.layers.spectral_resampling import resample_field

Pitch = tuple[float, float, float]
MAPS = 2
"""Multipliers of a spectral update that follow the noise."""


def small_conv(channels_in: int, channels_out: int, gain: float) -> SmallConv3d:
    """A 1x1x1 convolution whose initial kernel is scaled by `gain`: real mixing of channels."""
    layer = SmallConv3d(channels_in, channels_out, 1)
    nn.init.kaiming_normal_(layer.weight, nonlinearity="linear")
    layer.weight.data.mul_(gain)
    nn.init.zeros_(layer.bias)  # type: ignore[arg-type]
    return layer


def noise_gains(conditions: int, maps: int) -> nn.Sequential:
    """a(eta): (B, conditions) -> (B, maps), small at first."""
    last = nn.Linear(16, maps)
    last.weight.data.mul_(0.1)
    last.bias.data.zero_()
    return nn.Sequential(nn.Linear(conditions, 16), nn.GELU(), last)


class PlainIteration(nn.Module):
    """u <- u + W (g - u), then a 3x3x3 residual block: the update at the finest scale, without a spectrum."""

    def __init__(self, channels: int):
        super().__init__()
        self.step = small_conv(channels, channels, 0.3)
        self.refine = ResidualBlock(3, channels)

    def forward(self, u: Tensor, guide: Tensor, gains: Tensor, pitch: Pitch) -> Tensor:
        out: Tensor = self.refine(u + self.step(guide - u))
        return out


class SpectralIteration(nn.Module):
    """u <- u + W F^-1(T(f, eta) F g + S(f, eta) F u), then a 3x3x3 residual block (NANO, eqs. 11 and 12).

    T starts at 1 and S at -1, so the first update is W (g - u). Half of the channels go through the spectrum.
    """

    def __init__(self, channels: int, maps: int):
        super().__init__()
        half = channels // 2
        self.take_u, self.take_g = small_conv(channels, half, 1.0), small_conv(channels, half, 1.0)
        self.transmit = PhysicalMultiplier(half, start=1.0, maps=maps)
        self.normal = PhysicalMultiplier(half, start=-1.0, maps=maps)
        self.step = small_conv(half, channels, 0.3)
        self.refine = ResidualBlock(3, channels)

    def forward(self, u: Tensor, guide: Tensor, gains: Tensor, pitch: Pitch) -> Tensor:
        size = (u.shape[2], u.shape[3], u.shape[4])
        half_u, half_g = self.take_u(u), self.take_g(guide)
        with torch.autocast(u.device.type, enabled=False):
            spectrum_u = torch.fft.rfftn(half_u.float(), dim=(2, 3, 4), norm="ortho")
            spectrum_g = torch.fft.rfftn(half_g.float(), dim=(2, 3, 4), norm="ortho")
            update = self.transmit(gains, size, pitch) * spectrum_g + self.normal(gains, size, pitch) * spectrum_u
            change = torch.fft.irfftn(update, s=size, dim=(2, 3, 4), norm="ortho")
        out: Tensor = self.refine(u + self.step(change))
        return out


class PhysicalUnfolding(nn.Module):
    """Phi_eta in space and spectrum: J scales of n_j iterations, restriction by spectral truncation, skips upwards.

    features (B, F, D, H, W), eta (B, conditions), pitch of the grid in wall widths -> (B, channels[0], D, H, W).
    The lifted features are both u^0 and the guide u_g. The `spectral` coarsest scales have the spectral update.
    `width` (B,) is that of the instrument's response, of order 1, where it is told.
    """

    def __init__(
        self,
        features: int,
        channels: Sequence[int] = (16, 32, 48),
        iterations: int = 2,
        spectral: int = 2,
        conditions: int = 3,
        sfe_bandwidth: int = 0,
    ):
        super().__init__()
        scales = len(channels)
        self.lift_u = SmallConv3d(features, channels[0], 3, padding=1)
        self.lift_g = SmallConv3d(features, channels[0], 3, padding=1)
        self.gains = nn.ModuleList()
        self.iterations = nn.ModuleList()
        for scale, width in enumerate(channels):
            with_spectrum = scale >= scales - spectral
            self.gains.append(noise_gains(conditions, MAPS) if with_spectrum else nn.Identity())
            self.iterations.append(
                nn.ModuleList(
                    SpectralIteration(width, MAPS) if with_spectrum else PlainIteration(width)
                    for _ in range(iterations)
                )
            )
        pairs = list(pairwise(channels))
        self.restrict_u = nn.ModuleList(small_conv(fine, coarse, 1.0) for fine, coarse in pairs)
        self.restrict_g = nn.ModuleList(small_conv(fine, coarse, 1.0) for fine, coarse in pairs)
        self.prolong = nn.ModuleList(small_conv(coarse, fine, 0.5) for fine, coarse in pairs)
        self.refine = nn.ModuleList(ResidualBlock(3, fine) for fine, _ in pairs)
        self.sfe = StochasticFrequencyEncoding(channels[-1], sfe_bandwidth) if sfe_bandwidth else None
        self.spectral = min(spectral, scales)
        self.response = ResponseCondition(conditions, (channels[0], channels[0], *(MAPS,) * self.spectral))

    def encode_frequencies(self, u: Tensor) -> Tensor:
        """SFE of the coarsest scale, on its spectrum."""
        if self.sfe is None:
            return u
        with torch.autocast(u.device.type, enabled=False):
            spectrum = torch.fft.rfftn(u.float(), dim=(2, 3, 4), norm="ortho")
            encoded: Tensor = torch.fft.irfftn(self.sfe(spectrum), s=u.shape[2:], dim=(2, 3, 4), norm="ortho")
            return encoded

    def forward(self, features: Tensor, eta: Tensor, pitch: Pitch, width: Tensor | None = None) -> Tensor:
        u: Tensor = self.lift_u(features)
        guide: Tensor = self.lift_g(features)
        shifts: list[Tensor] = []
        if width is not None:
            of_u, of_g, *shifts = self.response(width, eta)
            of_u, of_g = (each.to(u.dtype)[:, :, None, None, None] for each in (of_u, of_g))
            u, guide = u + of_u, guide + of_g
        size = tuple(features.shape[2:])
        extent = tuple(n * step for n, step in zip(size, pitch, strict=True))
        outputs: list[Tensor] = []
        for scale, steps in enumerate(self.iterations):
            if scale:
                size = tuple((n + 1) // 2 for n in size)
                u = self.restrict_u[scale - 1](resample_field(u, size))
                guide = self.restrict_g[scale - 1](resample_field(guide, size))
            gains = self.gains[scale](eta)
            if shifts and scale >= len(self.iterations) - self.spectral:
                gains = gains + shifts.pop(0)
            here = (extent[0] / size[0], extent[1] / size[1], extent[2] / size[2])
            for step in cast(nn.ModuleList, steps):
                u = step(u, guide, gains, here)
            outputs.append(u)
        u = self.encode_frequencies(outputs.pop())
        for scale in range(len(outputs) - 1, -1, -1):
            fine = outputs[scale]
            u = self.refine[scale](fine + resample_field(self.prolong[scale](u), fine.shape[2:]).to(fine.dtype))
        return u
