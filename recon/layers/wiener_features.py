"""What a network sees of a measurement: Wiener volumes of the light cone at a regularisation chosen from the counts."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from acquisition.transient import TimeAxis
from acquisition.wall import WallGrid
from recon.transport.conventions import range_m
from recon.transport.light_cone import LightConeConvolution
from recon.transport.resampling import LightConeResampling

# Net counts per measured point (log10, plus 0.4 log10 of the measured share) -> falloff exponent and log10 snr at which
# the transform was best on simulated scenes.
LEVELS = (1.2, 1.9, 2.5, 3.9)
EXPONENTS = (2.0, 2.7, 3.0, 4.0)
LOG_SNRS = (-1.0, -0.9, -0.5, 0.3)
SNR_FACTORS = (0.5, 5.0)
QUANTILE = 0.98
SHARE_WEIGHT = 0.4
BLOCKS = 32


@dataclass(frozen=True)
class Features:
    """Volumes of order 1, their depths, and what is known of every wall point."""

    volumes: Tensor  # (B, V, D, H, W), one for each of SNR_FACTORS
    depths_m: Tensor  # (D,)
    level: Tensor  # (B,) log10 of net counts per measured point, reduced where few points were measured
    measured: Tensor  # (B, H, W) 1 or 0
    background: Tensor  # (B,) background counts a bin at mean exposure


def background_rate(counts: Tensor, exposure: Tensor) -> Tensor:
    """Background counts a bin at exposure 1, (B,): the low decile of the time axis' mean rates, empty bins aside.

    counts (B, 1, T, H, W), exposure (B, H, W).
    """
    rate = counts[:, 0].sum(dim=(2, 3)) / exposure.sum(dim=(1, 2)).clamp(min=1e-6)[:, None]  # (B, T)
    size = max(1, rate.shape[1] // BLOCKS)
    blocks = rate[:, : rate.shape[1] // size * size].reshape(len(rate), -1, size).mean(dim=2)
    lit = torch.where(blocks > 0, blocks, torch.nan)
    return torch.nanquantile(lit, 0.1, dim=1).nan_to_num(0.0)


def interpolate(x: Tensor, knots: tuple[float, ...], values: tuple[float, ...]) -> Tensor:
    """Piecewise linear, constant beyond the ends."""
    out = torch.full_like(x, values[0])
    for a, b, u, v in zip(knots[:-1], knots[1:], values[:-1], values[1:], strict=True):
        out = out + (v - u) * ((x - a) / (b - a)).clamp(0, 1)
    return out


def together(x: Tensor, count: int) -> Tensor:
    """(B, C, T, H, W) -> (B, C, T // count, count, H, W)."""
    return x.reshape(*x.shape[:2], -1, count, *x.shape[3:])


class WienerFeatures(nn.Module):
    """counts (B, 1, T, H, W) and relative exposure (B, H, W) -> `Features`; works in float32, needs no gradient.

    Bins are added up to the resolution that the wall allows, voxels averaged to slices of `slice_widths` of the wall's
    width between `nearest` and `farthest` wall widths; so any bin width, bin count and wall gives the same picture.
    """

    depths_m: Tensor

    def __init__(
        self,
        wall: WallGrid,
        time: TimeAxis,
        slice_widths: float = 0.0096,
        nearest: float = 0.125,
        farthest: float = 2.0,
    ) -> None:
        super().__init__()
        width = wall.width_m
        bin_m = range_m(TimeAxis(1, time.bin_width_s), "physical")
        self.together = max(1, round(slice_widths * width / 2 / bin_m))
        bins = time.bins // self.together
        if bins < 4:
            raise ValueError(f"{time.bins} bins of {time.bin_width_s * 1e12:g} ps are too few for this wall")
        self.time = TimeAxis(bins, time.bin_width_s * self.together, time.start_s)
        self.slice = max(1, round(slice_widths * width / (bin_m * self.together)))
        centres = self.time.centres_s() / self.time.bin_width_s * bin_m * self.together
        slices = centres[: bins // self.slice * self.slice].reshape(-1, self.slice).mean(axis=1)
        chosen = [k for k, z in enumerate(slices) if nearest * width <= z <= farthest * width]
        if not chosen:
            chosen = list(range(len(slices)))
        self.first, self.last = chosen[0] * self.slice, (chosen[-1] + 1) * self.slice
        self.register_buffer("depths_m", torch.tensor(slices[chosen], dtype=torch.float32), persistent=False)
        relative = torch.tensor(centres / centres[-1], dtype=torch.float32).clamp(min=0)
        self.register_buffer("relative", relative, persistent=False)
        self.resampling = LightConeResampling(self.time)
        self.cone = LightConeConvolution(wall, self.time)

    relative: Tensor

    @torch.no_grad()
    def forward(self, counts: Tensor, exposure: Tensor | None) -> Features:
        with torch.autocast(counts.device.type, enabled=False):
            counts = counts.float()
            if exposure is None:
                exposure = torch.ones_like(counts[:, 0, 0])
            measured = (exposure > 0).float()
            mean = (exposure * measured).sum(dim=(1, 2)) / measured.sum(dim=(1, 2)).clamp(min=1)
            exposure = exposure / mean.clamp(min=1e-12)[:, None, None]
            if self.together > 1:
                used = self.time.bins * self.together
                counts = together(counts[:, :, :used], self.together).sum(dim=3)
            background = background_rate(counts, exposure)
            rate = counts[:, 0] / exposure.clamp(min=1e-3)[:, None] - background[:, None, None, None]
            rate = rate * measured[:, None]
            points = measured.sum(dim=(1, 2)).clamp(min=1)
            share = points / measured[0].numel()
            net = (rate.sum(dim=(1, 2, 3)) / points).clamp(min=1.0)
            level = torch.log10(net) + SHARE_WEIGHT * torch.log10(share)
            exponent = interpolate(level, LEVELS, EXPONENTS)
            snr = 10 ** interpolate(level, LEVELS, LOG_SNRS)
            light = rate * self.relative[None, :, None, None] ** exponent[:, None, None, None]
            cells = self.resampling(light[:, None])
            volumes = []
            for factor in SNR_FACTORS:
                volume = self.resampling.adjoint(self.cone.wiener(cells, snr * factor))[:, 0, self.first : self.last]
                volume = together(volume[:, None], self.slice).mean(dim=3)[:, 0]
                brightest = torch.quantile(volume.amax(dim=1).flatten(1), QUANTILE, dim=1)
                scale = brightest.clamp(min=1e-6 * float(volume.abs().max()) + 1e-30)
                volumes.append((volume / scale[:, None, None, None]).clamp(-3, 4))
        return Features(torch.stack(volumes, dim=1), self.depths_m, level, measured, background)
