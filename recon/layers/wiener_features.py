"""What a network sees of a measurement: rates, how noisy they are, and Wiener volumes regularised accordingly."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.counts import added, exposed
from nlos.recon.layers.light_cone_inverse import brightest
from nlos.recon.layers.light_cone_layer import LightConeLayer
from nlos.recon.layers.noise_adapted import BY_COUNTS

SNR_FACTORS = (0.5, 5.0)
SHARE_WEIGHT = 0.4
FINEST_BIN_WIDTHS = 0.0048  # in wall widths of depth: finer bins are added up
BLOCKS = 32
LEAST_GAIN = 0.3  # variance over mean below which numbers cannot be counts, calibrated ones included
NOISELESS_PEAK = 20_000.0  # counts that a transient in other units is then taken for: the scale of training


@dataclass(frozen=True)
class Counted:
    """Counts over exposure without background, and how good they are."""

    rate: Tensor  # (B, 1, T, H, W) counts per bin at mean exposure, 0 where nothing was measured
    measured: Tensor  # (B, H, W) 1 or 0
    background: Tensor  # (B,) what was taken off
    net: Tensor  # (B,) counts per measured point, at least 1
    level: Tensor  # (B,) log10 of these, less where few points were measured

    @property
    def exponent(self) -> Tensor:
        return BY_COUNTS.exponent(self.level)

    @property
    def snr(self) -> Tensor:
        return BY_COUNTS.snr(self.level)


def bins_together(wall: WallGrid, time: TimeAxis) -> int:
    """How many bins are added to one: the resolution that the wall's pixels allow, the same for every wall."""
    depth_m = SPEED_OF_LIGHT_M_PER_S * time.bin_width_s / 2
    return max(1, round(FINEST_BIN_WIDTHS * wall.width_m / depth_m))


def rebinned(time: TimeAxis, together: int) -> TimeAxis:
    """The time axis after adding up; raises ValueError if nothing is left of it."""
    if time.bins // together < 8:
        raise ValueError(f"{time.bins} bins of {time.bin_width_s * 1e12:g} ps are too few for this wall")
    return TimeAxis(time.bins // together, time.bin_width_s * together, time.start_s)


def counted(counts: Tensor, exposure: Tensor | None, together: int = 1) -> Counted:
    """From counts (B, 1, T, H, W) and exposure (B, H, W) in any unit, 0 = not measured; None: all alike."""
    counts = added(counts.float(), together, counts.shape[2] // together)
    counts = counts * unit(counts)[:, None, None, None, None]
    exposure, known, points = exposed(counts, exposure)
    measured = known.float()
    background = background_rate(counts, exposure)
    rate = counts[:, 0] / exposure.clamp(min=1e-3)[:, None] - background[:, None, None, None]
    rate = rate * measured[:, None]
    net = (rate.sum(dim=(1, 2, 3)) / points).clamp(min=1.0)
    level = torch.log10(net) + SHARE_WEIGHT * torch.log10(points / measured[0].numel())
    return Counted(rate[:, None], measured, background, net, level)


def unit(counts: Tensor) -> Tensor:
    """What one unit of these numbers is in counts, (B,): 1, unless they are less noisy than counts can be.

    Noise is white along time and light is not, so the second difference along time is nearly all noise.
    """
    second = counts[:, :, 2:] - 2 * counts[:, :, 1:-1] + counts[:, :, :-2]
    variance = second.square().mean(dim=(1, 2, 3, 4)) / 6
    mean, peak = counts.mean(dim=(1, 2, 3, 4)), counts.amax(dim=(1, 2, 3, 4))
    return torch.where(variance < LEAST_GAIN * mean, NOISELESS_PEAK / peak.clamp(min=1e-30), 1.0)


def background_rate(counts: Tensor, exposure: Tensor) -> Tensor:
    """Background counts per bin at exposure 1, (B,): the low decile of the time axis' mean rates, empty bins aside."""
    rate = counts[:, 0].sum(dim=(2, 3)) / exposure.sum(dim=(1, 2)).clamp(min=1e-6)[:, None]  # (B, T)
    size = max(1, rate.shape[1] // BLOCKS)
    blocks = rate[:, : rate.shape[1] // size * size].reshape(len(rate), -1, size).mean(dim=2)
    lit = torch.where(blocks > 0, blocks, torch.nan)
    return torch.nanquantile(lit, 0.1, dim=1).nan_to_num(0.0)


def normalised(volumes: Tensor) -> Tensor:
    """Every volume (B, V, D, H, W) divided by the 0.98 quantile of its own maximum projection."""
    floor = 1e-6 * volumes.detach().abs().amax(dim=(2, 3, 4)) + 1e-30
    return volumes / torch.maximum(brightest(volumes.detach()), floor)[:, :, None, None, None]


@dataclass(frozen=True)
class Features:
    """Volumes of order 1, one for each of SNR_FACTORS, and what they were made from."""

    volumes: Tensor  # (B, V, D, H, W)
    depths_m: Tensor  # (D,)
    counted: Counted


class WienerFeatures(nn.Module):
    """counts (B, 1, T, H, W) and exposure (B, H, W) -> `Features`, in float32 and without gradient."""

    def __init__(self, wall: WallGrid, time: TimeAxis, farthest: float = 2.0) -> None:
        super().__init__()
        self.together = bins_together(wall, time)
        self.light_cone = LightConeLayer(wall, rebinned(time, self.together), farthest=farthest)

    @torch.no_grad()
    def forward(self, counts: Tensor, exposure: Tensor | None) -> Features:
        seen = counted(counts, exposure, self.together)
        snr = torch.stack([seen.snr * factor for factor in SNR_FACTORS], dim=1)
        volumes = normalised(self.light_cone(seen.rate, seen.exponent, snr)).clamp(-3, 4)
        return Features(volumes, self.light_cone.depths_m, seen)
