"""From raw counts to what the operator reads: rates, background, noise statistics, and noise-adapted Wiener volumes.

Lengths are in wall widths: confocal imaging is similar under scaling, so one set of weights serves every wall.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.told_response import BANDS, MIDDLE, Told
from nlos.recon.transport.light_cone import LightConeConvolution
from nlos.recon.transport.resampling import LightConeResampling
from nlos.recon.transport.response_bands import knots, windows

FINEST_BIN = 0.0049  # depth of a time bin in wall widths up to which neighbours are added
SLICE = 0.0096  # depth of a slice of the Wiener volumes, 19 mm behind a wall of 2 m
FARTHEST = 2.0
TRAINED_SLICES = 128
NOISE_KNOTS = (-1.83, -1.53, -1.13, -0.83, -0.53, -0.33)  # log10 of the noise level
FALLOFF_AT_KNOTS = (4.0, 3.5, 3.0, 2.4, 2.0, 1.6)  # of diffuse surfaces, whose light falls off with r^4
DIFFUSE = 4.0
LOG_SNR_AT_KNOTS = (0.8, 0.4, -0.4, -0.8, -1.2, -1.6)
SNR_FACTORS = (0.4, 4.0)
VOLUMES = len(SNR_FACTORS) + 1
ALIASING = (
    0.5  # noise power of leaving gaps empty, over that of the signal, for each point not measured per point measured
)
SPECTRUM_BYTES = 1 << 29  # held of the light cone's spectrum at a time
SHARPENED = 0.5  # of a response's width is inverted: the network does the rest better (docs/decisions/185)
TREND = 3
STEEPEST = 0.3


@dataclass(frozen=True)
class Rates:
    """Counts over exposure, background removed, holes filled, in units of the mean net rate of a voxel."""

    net: Tensor  # (B, 1, T, H, W), filled
    unfilled: Tensor  # (B, 1, T, H, W), 0 where not measured; `net` itself where nothing is missing
    raw: Tensor  # (B, 1, T, H, W), with background, 0 where not measured
    exposure: Tensor  # (B, H, W), mean 1 over the measured points, 0 = not measured
    background: Tensor  # (B,) in the same units
    kept: Tensor  # (B,) share of the points that were measured
    presence: Tensor  # (B,) 0 = nothing but noise, 1 = there is a signal


def piecewise(x: Tensor, knots: tuple[float, ...], values: tuple[float, ...]) -> Tensor:
    """Linear interpolation of `values` at `knots`, constant beyond them."""
    result = torch.full_like(x, values[0])
    for left, right, a, b in zip(knots[:-1], knots[1:], values[:-1], values[1:], strict=True):
        result = result + (b - a) * ((x - left) / (right - left)).clamp(0, 1)
    return result


def blur_matrix(n: int, sigma: float) -> Tensor:
    """(n, n): Gaussian weights between samples, with a faint wide tail so that no sample is out of reach."""
    distance = (torch.arange(n)[:, None] - torch.arange(n)[None]).abs().float()
    tail = 1e-4 * torch.exp(-0.5 * (distance / (4 * sigma)).square())
    return torch.exp(-0.5 * (distance / sigma).square()) + tail


def fill(counts: Tensor, exposure: Tensor) -> Tensor:
    """Rates everywhere from counts (B, 1, T, H, W) and exposure (B, H, W): where points are missing, Gaussian averages
    of the counts over those of the exposure, as wide as the mean spacing of the points asks for."""
    result = []
    for sample, weight in zip(counts, exposure, strict=True):
        measured = weight > 0
        kept = float(measured.float().mean())
        if kept in (0.0, 1.0):
            result.append(sample / weight.clamp(min=1e-6))
            continue
        sigma = max(0.4 / kept**0.5, 0.4)
        rows, cols = (blur_matrix(n, sigma).to(sample) for n in weight.shape)
        result.append((rows @ sample @ cols) / (rows @ weight @ cols).clamp(min=1e-12))
    return torch.stack(result)


def presence(rates: Tensor, exposure: Tensor) -> Tensor:
    """(B,) from 0 to 1: does the mean histogram vary more than its noise allows? An F test, so free of the count unit.

    Under a flat rate the variance of the mean over N points is 1/N of that of the points, whatever a photon counts.
    Slow changes of a background are no signal (`without_trend`). Bins that are empty everywhere (cut by a calibration)
    say nothing and are skipped.
    """
    measured = (exposure > 0).float()[:, None]  # (B, 1, H, W)
    points = measured.sum(dim=(1, 2, 3)).clamp(min=2)
    x = rates[:, 0] * measured
    profile = x.sum(dim=(2, 3)) / points[:, None]  # (B, T)
    used = (profile != 0).float()
    bins = used.sum(dim=1).clamp(min=TREND + 2)
    within = ((x - profile[..., None, None]).square() * measured).sum(dim=(2, 3)) / (points[:, None] - 1)
    within = (within * used).sum(dim=1) / bins
    between = without_trend(profile, used).square().sum(dim=1) / (bins - 1 - TREND) * points
    spread = (2 / bins).sqrt()
    return ((between / within.clamp(min=1e-30) - 1 - 5 * spread) / (5 * spread)).clamp(0, 1)


def without_trend(profile: Tensor, used: Tensor) -> Tensor:
    """Mean histograms (B, T) without their mean and slow trend, 0 in the bins that are not used.

    The trend is a polynomial of degree TREND: what afterpulses and the pile-up of ambient light make of a flat
    background. It is taken off as far as it lies within STEEPEST of the mean; light of a scene goes further.
    """
    time = torch.linspace(-1, 1, profile.shape[1], dtype=torch.float64, device=profile.device)
    powers = torch.stack([time**k for k in range(TREND + 1)], dim=1)[None] * used.double()[..., None]  # (B, T, K)
    seen = (profile * used).double()[..., None]
    normal = powers.transpose(1, 2) @ powers + 1e-9 * torch.eye(TREND + 1, dtype=torch.float64, device=profile.device)
    trend = powers @ torch.linalg.solve(normal, powers.transpose(1, 2) @ seen)
    mean = seen.sum(dim=1, keepdim=True) / used.double().sum(dim=1).clamp(min=1)[:, None, None]
    within = torch.minimum(torch.maximum(trend - mean, -STEEPEST * mean.abs()), STEEPEST * mean.abs())
    rest: Tensor = (seen - mean - within)[..., 0].to(profile) * used
    return rest


def estimate_background(profile: Tensor) -> Tensor:
    """(B,) rate of a bin without signal, from mean histograms (B, T): the low decile of their 8-bin averages.

    Bins that are exactly 0 were cut or hold no photon at all; they count only where nearly all are so.
    """
    smooth = F.avg_pool1d(profile[:, None], 8, stride=4)[:, 0]
    result = []
    for row in smooth:
        some = row[row != 0]
        result.append(some.quantile(0.1) if len(some) > 0.5 * len(row) else row.min())
    return torch.stack(result)


def rates_of(counts: Tensor, exposure: Tensor | None) -> Rates:
    """counts (B, 1, T, H, W) and exposure (B, H, W) or None for an even one -> Rates.

    Before the first count of all and after the last there is no background either: those bins were cut.
    """
    counts = counts.float()
    if exposure is None:
        exposure = counts.new_ones(counts.shape[0], *counts.shape[3:])
    exposure = exposure.to(counts)
    measured = exposure > 0
    points = measured.sum(dim=(1, 2)).clamp(min=1)
    exposure = exposure / (exposure.sum(dim=(1, 2)) / points).clamp(min=1e-30)[:, None, None]
    counts = torch.where(measured[:, None, None], counts, 0.0)  # whatever stands where nothing was measured
    raw = counts / exposure.clamp(min=1e-6)[:, None, None]
    profile = counts.sum(dim=(1, 3, 4)) / points[:, None]  # weighted by exposure, so by precision
    background = estimate_background(profile)
    level = (profile.mean(dim=1) - background).clamp(min=0)
    present = presence(raw, exposure) * (level > 0)
    unit = torch.where(level > 0, level, 1.0)
    scale = unit[:, None, None, None, None]
    recorded = ((profile.cumsum(dim=1) > 0) & (profile.flip(1).cumsum(dim=1).flip(1) > 0)).to(counts)
    flat = (background[:, None] * recorded)[:, None, :, None, None] * exposure[:, None, None]
    signal = (counts - flat) * measured[:, None, None]
    net = fill(signal, exposure) / scale
    return Rates(
        net=net,
        unfilled=net if bool(measured.all()) else signal / exposure.clamp(min=1e-6)[:, None, None] / scale,
        raw=raw / scale,
        exposure=exposure,
        background=background / unit,
        kept=points / measured[0].numel(),
        presence=present,
    )


def last_light(net: Tensor) -> int:
    """The last time bin with light in any of (B, 1, T, H, W) net rates: mean histograms five deviations above 0.

    Noise beyond it, magnified by r^4, would only drown what is nearer. T where nothing stands out.
    """
    profile = net.mean(dim=(1, 3, 4))  # (B, T)
    around = F.avg_pool1d(profile[:, None], 9, stride=1, padding=4)[:, 0]
    steps = profile.diff(dim=1)
    deviation = 1.4826 / (2 * 9) ** 0.5 * steps.abs().median(dim=1, keepdim=True).values
    lit = around > torch.maximum(5 * deviation, 0.01 * around.amax(dim=1, keepdim=True)).clamp(min=1e-12)
    where = lit.any(dim=0).nonzero()
    return int(where[-1]) + 1 if len(where) else profile.shape[1]


def rebinned_axis(wall: WallGrid, time: TimeAxis) -> tuple[int, TimeAxis]:
    """How many neighbouring bins are added, and the axis of the sums: none finer than FINEST_BIN unless the data's own
    is all there is, none beyond FARTHEST."""
    bin_depth = SPEED_OF_LIGHT_M_PER_S * time.bin_width_s / 2 / max(wall.width_m, wall.height_m)
    factor = max(1, math.floor(FINEST_BIN / bin_depth + 1e-6))
    last = math.ceil((FARTHEST - time.start_s / time.bin_width_s * bin_depth) / (bin_depth * factor))
    bins = max(8, min(-(-time.bins // factor), last))
    return factor, replace(time, bins=bins, bin_width_s=time.bin_width_s * factor)


class WienerVolumes(nn.Module):
    """Wiener inverses of the light cone, falloff and snr chosen by the noise: what the operator starts from.

    u_g of NANO (section IV-B2) with the falloff and snr that were best at each noise level: two of the filled rates,
    and the sharper of them once more of the rates with their gaps left empty. Filling blurs what lies between the
    points, empty gaps alias it; a network sees both. `time` is the axis of the counts; `slices` depths of about SLICE
    wall widths come out, from the wall to the end of the axis. `falloff` 2 is for retroreflective surfaces, from which
    less has to be undone.
    """

    def __init__(self, wall: WallGrid, time: TimeAxis, falloff: float = DIFFUSE):
        super().__init__()
        self.falloff = falloff
        unit_m = max(wall.width_m, wall.height_m)
        self.wall, self.unit_m = wall, unit_m
        self.factor, self.time = rebinned_axis(wall, time)
        self.bins = self.time.bins
        bin_depth = SPEED_OF_LIGHT_M_PER_S * self.time.bin_width_s / 2 / unit_m
        bin_depths = self.time.centres_s() * (SPEED_OF_LIGHT_M_PER_S / 2 / unit_m)
        self.first = int(np.searchsorted(bin_depths, 0.0))
        extent = (self.bins - self.first) * bin_depth
        self.slices = max(4, round(extent / SLICE))
        self.pitch = (extent / self.slices, wall.height_m / wall.rows / unit_m, wall.width_m / wall.cols / unit_m)
        near = float(bin_depths[self.first]) - bin_depth / 2
        relative = torch.from_numpy(np.maximum(bin_depths, 0.0)).float()
        self.register_buffer("depths", near + (torch.arange(self.slices) + 0.5) * self.pitch[0], persistent=False)
        self.register_buffer("relative", relative, persistent=False)
        self.resampling = LightConeResampling(self.time)
        plane = 8 * len(SNR_FACTORS) * wall.rows * wall.cols
        self.cone = LightConeConvolution(wall, self.time, tile=max(1, SPECTRUM_BYTES // plane))

    depths: Tensor
    relative: Tensor

    def rebin(self, counts: Tensor) -> Tensor:
        """(B, 1, T, H, W) -> (B, 1, bins, H, W): neighbouring bins added, what is too far cut."""
        used = counts[:, :, : self.bins * self.factor]
        if missing := self.bins * self.factor - used.shape[2]:
            used = F.pad(used, (0, 0, 0, 0, 0, missing))
        batch, channels, _, rows, cols = used.shape
        return used.reshape(batch, channels, self.bins, self.factor, rows, cols).sum(dim=3)

    def forward(self, rates: Rates, log_noise: Tensor, response: Told | None = None) -> Tensor:
        """rates of (B, 1, bins, H, W), log10 noise level (B,) -> (B, VOLUMES, slices, H, W)."""
        undone = piecewise(log_noise, NOISE_KNOTS, FALLOFF_AT_KNOTS)
        exponent = (undone - (DIFFUSE - self.falloff)).clamp(min=0)
        weight = (self.relative[None] ** exponent[:, None])[:, None, :, None, None]
        snr = 10 ** piecewise(log_noise, NOISE_KNOTS, LOG_SNR_AT_KNOTS)
        snr_of = [snr * factor for factor in SNR_FACTORS]
        aliased = 1 / (1 / snr_of[-1] + ALIASING * (1 / rates.kept - 1))
        if response is not None:
            return self.sharpened(rates, weight, snr_of, aliased, response)
        filled = self.resampling(rates.net * weight).repeat(1, len(SNR_FACTORS), 1, 1, 1)
        volumes = self.slices_of(self.cone.wiener(filled, torch.stack(snr_of, dim=1)))
        if bool((rates.kept == 1).all()):
            return torch.cat((volumes, volumes[:, -1:]), dim=1)
        empty = self.slices_of(self.cone.wiener(self.resampling(rates.unfilled * weight), aliased))
        return torch.cat((volumes, empty), dim=1)

    def sharpened(self, rates: Rates, weight: Tensor, snr_of: list[Tensor], aliased: Tensor, response: Told) -> Tensor:
        """The same three volumes, the response inverted with the light cone: the blurred one about the middle of the
        light alone, the sharp ones in bands of time."""
        spread = response.spectra(self.time, self.resampling.cells, self.cone.padded[0])
        weights = torch.from_numpy(np.stack([windows(knots_s, self.time) for knots_s in response.knots_s])).to(weight)

        def inverted(net: Tensor, snr: Tensor) -> Tensor:
            parts = self.resampling(net * weights[..., None, None])
            return self.slices_of(self.cone.wiener(parts, snr, spread).sum(dim=1, keepdim=True))

        net = rates.net * weight
        blurred = self.cone.wiener(self.resampling(net), snr_of[0], spread[:, MIDDLE])
        sharp = inverted(net, snr_of[1])
        whole = bool((rates.kept == 1).all())
        empty = sharp if whole else inverted(rates.unfilled * weight, aliased)
        return torch.cat((self.slices_of(blurred), sharp, empty), dim=1)

    def told(self, taps: Tensor, bin_width_s: float, net: Tensor) -> Told:
        """A response (B, K), narrowed to SHARPENED of its width, and BANDS times from the first light of `net` rates to
        the end of the axis, evenly over log t."""
        profiles = net.detach().mean(dim=(1, 3, 4)).cpu().numpy()
        return Told(taps.to(net), SHARPENED * bin_width_s, [knots(profile, self.time, BANDS) for profile in profiles])

    def slices_of(self, solved: Tensor) -> Tensor:
        """(B, V, cells, H, W) on the light cone -> (B, V, slices, H, W)."""
        volume = self.resampling.adjoint(solved)[:, :, self.first :]
        size = (self.slices, *volume.shape[3:])
        if self.slices <= volume.shape[2]:
            return F.adaptive_avg_pool3d(volume, size)
        return F.interpolate(volume, size=size, mode="trilinear", align_corners=False)
