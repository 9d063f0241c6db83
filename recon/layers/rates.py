"""From raw counts to what NANO reads: rates without background, gaps filled, in a unit of their own."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from nlos.recon.gate import open_bins
from nlos.recon.layers.counts import exposed

TREND = 3
STEEPEST = 0.3
FEW = 200
"""Points up to which light is looked for point by point as well."""
WINDOW, CLUMPED = 16, (1.5, 2.0)
AROUND = 4
"""Time bins before and behind each over which a mean histogram is averaged."""
STANDS_OUT, FAINTEST = 5.0, 2e-5
"""Deviations by which light stands out of noise, and the least deviation, of the brightest, where there is no noise."""
ENOUGH = 1024
"""Points by which a gate is judged, at most."""


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
    say nothing and are skipped. Of `FEW` points each is asked alone, too (`clumped`).
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
    found = ((between / within.clamp(min=1e-30) - 1 - 5 * spread) / (5 * spread)).clamp(0, 1)
    if float(points.min()) > FEW:
        return found
    each = zip(rates[:, 0], used > 0, exposure > 0, strict=True)
    alone = [clumped(one[bins_used][:, at].T) if int(at.sum()) <= FEW else 0.0 for one, bins_used, at in each]
    return torch.maximum(found, found.new_tensor(alone))


def clumped(histograms: Tensor) -> float:
    """From 0 to 1: do the histograms of points (P, T) vary more over `WINDOW`s of bins than from bin to bin?

    Points that are few and far apart see a surface at times of their own, which a mean over them does not hold. Under
    a flat rate, a slow trend aside, the ratio is about 1, whatever a photon counts: 1.25 at most in 2,700 scans of 25
    to 144 points with ambient light that varies, a slope of a quarter and afterpulses. Light is told from `CLUMPED` on.
    """
    windows = histograms.shape[1] // WINDOW
    if windows < TREND + 3:
        return 0.0
    noise = float(histograms.diff(dim=1).square().mean()) / 2
    means = histograms[:, : windows * WINDOW].reshape(len(histograms), windows, WINDOW).mean(dim=2)
    rest = float(without_trend(means, torch.ones_like(means)).square().sum()) / (len(means) * (windows - 1))
    low, high = CLUMPED
    return min(max((rest * WINDOW / max(noise, 1e-30) - low) / (high - low), 0.0), 1.0)


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


def estimate_background(profile: Tensor, opened: Tensor | None = None) -> Tensor:
    """(B,) rate of a bin without signal, from mean histograms (B, T): the low decile of their 8-bin averages.

    Bins that are exactly 0 were cut or hold no photon at all; they count only where nearly all are so, and not where a
    gate was shut: `opened` (B, T) is False there.
    """
    smooth = F.avg_pool1d(profile[:, None], 8, stride=4)[:, 0]
    result = []
    for which, row in enumerate(smooth):
        if opened is not None and not bool(opened[which].all()):
            row = F.avg_pool1d(profile[which][opened[which]][None], 8, stride=4)[0]
        some = row[row != 0]
        result.append(some.quantile(0.1) if len(some) > 0.5 * len(row) else row.min())
    return torch.stack(result)


def not_shut(counts: Tensor, measured: Tensor, profile: Tensor) -> Tensor:
    """(B, T) False where a gate was shut, by counts (B, 1, T, H, W) at the points `measured` (B, H, W) and their mean
    histograms (B, T)."""
    opened = torch.ones_like(profile, dtype=torch.bool)
    empty = (profile == 0) & (profile.cumsum(dim=1) != 0)
    for which in empty.any(dim=1).nonzero()[:, 0].tolist():
        histograms = counts[which, 0][:, measured[which]]
        some = histograms[:, :: -(-histograms.shape[1] // ENOUGH)]
        gate = open_bins(some.detach().cpu().numpy())
        if gate is not None:
            opened[which] = torch.from_numpy(gate).to(opened.device)
    return opened


def rates_of(counts: Tensor, exposure: Tensor | None) -> Rates:
    """counts (B, 1, T, H, W) and exposure (B, H, W) or None for an even one -> Rates.

    Before the first count of all and after the last there is no background either: those bins were cut. Nor is there
    where a gate was shut.
    """
    counts = counts.float()
    exposure, measured, points = exposed(counts, exposure)
    counts = torch.where(measured[:, None, None], counts, 0.0)  # whatever stands where nothing was measured
    raw = counts / exposure.clamp(min=1e-6)[:, None, None]
    profile = counts.sum(dim=(1, 3, 4)) / points[:, None]  # weighted by exposure, so by precision
    opened = not_shut(counts, measured, profile)
    background = estimate_background(profile, opened)
    within = (profile.cumsum(dim=1) > 0) & (profile.flip(1).cumsum(dim=1).flip(1) > 0)
    recorded = (within & opened).to(counts)
    level = (profile.mean(dim=1) - background * recorded.mean(dim=1)).clamp(min=0)
    present = presence(raw, exposure) * (level > 0)
    unit = torch.where(level > 0, level, 1.0)
    scale = unit[:, None, None, None, None]
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


def lit_bins(net: Tensor) -> tuple[int, int]:
    """From which time bin to which there is light in any of (B, 1, T, H, W) net rates: mean histograms five deviations
    above 0, and a hundredth of the brightest, or rising again behind that (`_comes_again`).

    Noise beyond the last, magnified by r^4, would only drown what is nearer. 0 and T where nothing stands out.
    """
    profile = net.mean(dim=(1, 3, 4))  # (B, T)
    around = F.avg_pool1d(profile[:, None], 2 * AROUND + 1, stride=1, padding=AROUND)[:, 0]
    steps, brightest = profile.diff(dim=1), around.amax(dim=1, keepdim=True)
    deviation = 1.4826 / (2 * (2 * AROUND + 1)) ** 0.5 * steps.abs().median(dim=1, keepdim=True).values
    lit = around > torch.maximum(STANDS_OUT * deviation, 0.01 * brightest).clamp(min=1e-12)
    where = lit.any(dim=0).nonzero()
    if not len(where):
        return 0, profile.shape[1]
    end = int(where[-1]) + 1
    again = _comes_again(around[:, end:], steps[:, end - 1 :], torch.maximum(deviation, FAINTEST * brightest))
    return max(0, int(where[0]) - AROUND), end + again


def _comes_again(around: Tensor, steps: Tensor, deviation: Tensor) -> int:
    """The bin after the last in which mean histograms (B, T) have risen above what they had fallen to, by more than
    noise does; 0 where none has. Light of one surface falls for good, so what rises is another, which fades with
    distance: at 1.3 m as large and bright a one as at 0.25 m sends a thousandth of the light."""
    if not steps.shape[1]:
        return 0
    noise = steps.square().mean(dim=1, keepdim=True).sqrt() / (2 * (2 * AROUND + 1)) ** 0.5
    risen = around - around.cummin(dim=1).values
    there = (risen > 2**0.5 * STANDS_OUT * torch.maximum(deviation, noise)).any(dim=0).nonzero()
    return int(there[-1]) + 1 if len(there) else 0
