"""Noise level estimation: a small 3D U-Net reads the noise off a measurement, as one number and as a map."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.recon.layers.unet import UNet

WINDOWS = ((1, 1), (1, 3), (3, 3), (3, 7), (5, 15))  # bins, wall points
DIM = (0.7, 2.0, 100.0)  # in mean rates: the dim part, all but the peaks, everything
LAGS = (1, 2, 4, 8)  # bins
MIDDLING = -0.07  # log10 of the signal's contraharmonic mean over its mean peak, in a middling scene
FLOOR = 1e-6
KNOWN = 1 + 2 * len(DIM) + len(LAGS) + len(WINDOWS)


class NoiseLevel(nn.Module):
    """(eta, D_n) = U-Net_3D(tau) (NANO, section IV-A): log10 noise level (B,) and log10 noise map (B, H, W).

    The noise level is the standard deviation of a time bin's rate over the mean peak of the signal, as the training
    data define it. Input: rates (B, 1, T, H, W) in units of the mean net rate, background included, and exposure
    (B, H, W), 0 where nothing was measured; there the map is +inf. Where a scan is dim, neighbouring bins differ by
    noise alone; half their mean square difference over their mean is what one photon counts. The root of that and of
    the mean rate, over the mean square of the signal (from products of different bins, which noise does not bias), is
    the first guess. The network corrects it, from the same in brighter parts, over longer lags, and from the peaks of
    averages over ever larger windows.
    """

    def __init__(self, widths: tuple[int, ...] = (8, 16, 24)):
        super().__init__()
        self.network = UNet(3, 3, widths[0], widths, stride=(2, 2, 2))
        last = nn.Linear(32, 1)
        nn.init.zeros_(last.weight)
        nn.init.constant_(last.bias, MIDDLING)
        inputs = 2 * widths[-1] + KNOWN
        self.scalar = nn.Sequential(nn.Linear(inputs, 32), nn.GELU(), nn.Linear(32, 32), nn.GELU(), last)
        end = nn.Conv2d(16, 1, 1)
        nn.init.zeros_(end.weight)
        nn.init.zeros_(end.bias)  # type: ignore[arg-type]
        self.map = nn.Sequential(nn.Conv2d(2 * widths[0] + 2, 16, 3, padding=1), nn.ReLU(), end)

    def forward(self, rates: Tensor, exposure: Tensor) -> tuple[Tensor, Tensor]:
        eta, noise_map, _ = self.with_statistics(rates, exposure)
        return eta, noise_map

    def with_statistics(self, rates: Tensor, exposure: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The same, and what the estimate rests on: see `everywhere`."""
        eta, spread, known = self.everywhere(rates, exposure)
        return eta, noise_map_of(eta, spread, exposure), known

    def everywhere(self, rates: Tensor, exposure: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The level (B,), by how much each wall point would differ from it were it exposed as long as all are on
        average (B, H, W), and what both rest on, (B, KNOWN) log10: of the points the share that was measured, rate and
        spread of the `DIM` parts, the signal's power at the `LAGS`, its mean peak over the `WINDOWS`."""
        measured = (exposure > 0).float()[:, None, None]  # (B, 1, 1, H, W)
        difference = 0.5 * torch.diff(rates, dim=2, prepend=rates[:, :, :1]).square()
        seen = (exposure[:, None, None] * measured).expand_as(rates)
        inputs = torch.cat((torch.log1p(rates.clamp(min=0)), torch.log1p(difference), seen), dim=1)
        features = self.network.encode(inputs)
        share = F.adaptive_avg_pool3d(measured, (1, *features[-1].shape[3:]))
        share = share / share.mean(dim=(3, 4), keepdim=True).clamp(min=FLOOR)
        pooled = (features[-1].float() * share).mean(dim=(2, 3, 4))

        points = measured.mean(dim=(1, 2, 3, 4)).clamp(min=FLOOR)
        mean = rates.mean(dim=(1, 2, 3, 4)) / points
        each_bin = [field.mean(dim=(1, 3, 4)) / points[:, None] for field in (rates, difference)]  # (B, T)
        parts = [part_below(limit * mean, *each_bin) for limit in DIM]
        counted = [part[1] / part[0].clamp(min=FLOOR) for part in parts]
        photon = torch.where(counted[0] > 0, counted[0], counted[-1])
        powers = [signal_power(rates, points, mean - 1, lag) for lag in LAGS]
        statistics = [points, *(value for part in parts for value in part), *powers]
        statistics += [mean_peak(rates, measured, *window) for window in WINDOWS]
        known = torch.stack([log10_of(value, FLOOR) for value in statistics], dim=1)
        guess = 0.5 * log10_of(photon * mean, FLOOR) - log10_of(powers[0], FLOOR)
        rest = self.scalar(torch.cat((pooled, torch.log1p(pooled.abs()), known), dim=1))[:, 0].float()
        eta = guess + rest

        each = (slice(None), None, None, None)
        fine = self.network.decode(features)
        bright = blurred(rates.mean(dim=2), measured[:, :, 0]) / mean.clamp(min=FLOOR)[each]
        spread = blurred(difference.mean(dim=2), measured[:, :, 0]) / (photon * mean).clamp(min=FLOOR)[each]
        local = (0.5 * log10_of(torch.cat((bright, spread), dim=1), 1e-3)).clamp(-2, 2)
        coarse = F.adaptive_avg_pool2d(local, (fine.shape[3], fine.shape[4]))
        shape = self.map(torch.cat((fine.mean(dim=2), fine.amax(dim=2), coarse), dim=1)).float()
        shape = F.interpolate(shape, size=exposure.shape[1:], mode="bilinear", align_corners=False)[:, 0]
        return eta, local[:, 0] + shape, known  # Poisson noise goes with the root of the rate


def noise_map_of(eta: Tensor, spread: Tensor, exposure: Tensor) -> Tensor:
    """D_n (B, H, W) from level and spread: a longer dwell averages noise away; +inf where nothing was measured."""
    noise = eta[:, None, None] + spread - 0.5 * exposure.clamp(min=FLOOR).log10()
    return torch.where(exposure > 0, noise, torch.inf)


def log10_of(value: Tensor, least: float) -> Tensor:
    """log10 of a quantity that noise can bring below 0, as it does to counts less their mean background."""
    return (value.clamp(min=0) + least).log10()


def part_below(limit: Tensor, profile: Tensor, spread: Tensor) -> tuple[Tensor, Tensor]:
    """Means (B,) of both, (B, T), over the time bins around which `profile` is below `limit`."""
    around = F.avg_pool1d(profile[:, None], 9, stride=1, padding=4, count_include_pad=False)[:, 0]
    dim = (around < limit[:, None]).float()
    count = dim.sum(dim=1).clamp(min=1)
    return (profile * dim).sum(dim=1) / count, (spread * dim).sum(dim=1) / count


def signal_power(rates: Tensor, points: Tensor, background: Tensor, lag: int) -> Tensor:
    """(B,) mean product of the signal with itself `lag` bins later, in units of its mean; at least 1."""
    product = (rates[:, :, lag:] * rates[:, :, :-lag]).mean(dim=(1, 2, 3, 4)) / points
    return (product - background.square() - 2 * background).clamp(min=1)


def averaged(field: Tensor, bins: int, points: int) -> Tensor:
    """Box averages of (B, 1, T, H, W), odd windows, along one axis after the other, so that the cost stays linear."""
    points = min(points, (min(field.shape[3:]) - 1) // 2 * 2 + 1)
    for dim, window in ((2, bins), (3, points), (4, points)):
        field = averaged_along(field, dim, window)
    return field


def averaged_along(field: Tensor, dim: int, window: int) -> Tensor:
    """Averages over `window` (odd) neighbours along `dim`, zeros beyond the ends: F.avg_pool3d's, on a CPU 15 times as
    fast."""
    if window == 1:
        return field
    if field.device.type != "cpu":
        sizes = [window if axis == dim else 1 for axis in (2, 3, 4)]
        return F.avg_pool3d(field, sizes, stride=1, padding=[size // 2 for size in sizes])
    size = field.shape[dim]
    padding = [0] * (2 * (field.ndim - dim - 1)) + [window // 2, window // 2]
    padded = F.pad(field, padding)
    total = padded.narrow(dim, 0, size).clone()
    for shift in range(1, window):
        total += padded.narrow(dim, shift, size)
    return total / window


def mean_peak(rates: Tensor, measured: Tensor, bins: int, points: int) -> Tensor:
    """(B,) mean over the wall of the highest rate along time, after averages over `bins` x `points` x `points`."""
    mean = averaged(rates, bins, points) / averaged(measured, 1, points).clamp(min=0.25 / points**2)
    peak = mean.amax(dim=2, keepdim=True) * measured
    return peak.sum(dim=(1, 2, 3, 4)) / measured.sum(dim=(1, 2, 3, 4)).clamp(min=1)


def blurred(picture: Tensor, measured: Tensor) -> Tensor:
    """(B, 1, H, W) averaged over 5 x 5 points, of those that were measured."""
    mean = F.avg_pool2d(picture * measured, 5, stride=1, padding=2)
    return mean / F.avg_pool2d(measured, 5, stride=1, padding=2).clamp(min=0.01)
