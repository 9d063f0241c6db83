"""Noise level estimation: a small 3D U-Net reads the noise off a measurement, as one number and as a map."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from recon.layers.unet import UNet

MEAN_OVER_PEAK = -1.45  # log10 of the mean net rate over the mean peak, in a middling scene


class NoiseLevel(nn.Module):
    """(eta, D_n) = U-Net_3D(tau) (NANO, section IV-A): log10 noise level (B,) and log10 noise map (B, H, W).

    The noise level is the standard deviation of a time bin's rate over the mean peak of the signal, as the training
    data define it. Input: rates (B, 1, T, H, W) in units of the mean net rate, background included, and exposure
    (B, H, W), 0 where nothing was measured; there the map is +inf. Neighbouring bins differ by noise far more than by
    signal: half the mean square of their difference is the first guess, which the network corrects for what the
    signal adds and for the peak that the noise is told against.
    """

    def __init__(self, widths: tuple[int, ...] = (8, 16, 24)):
        super().__init__()
        self.network = UNet(3, 3, widths[0], widths, stride=(4, 2, 2))
        last = nn.Linear(32, 1)
        nn.init.zeros_(last.weight)
        nn.init.constant_(last.bias, MEAN_OVER_PEAK)
        self.scalar = nn.Sequential(nn.Linear(2 * widths[-1] + 3, 32), nn.GELU(), last)
        self.map = nn.Sequential(nn.Conv2d(2 * widths[0], 16, 3, padding=1), nn.ReLU(), nn.Conv2d(16, 1, 1))

    def forward(self, rates: Tensor, exposure: Tensor) -> tuple[Tensor, Tensor]:
        measured = (exposure > 0).float()[:, None, None]  # (B, 1, 1, H, W)
        difference = torch.diff(rates, dim=2, prepend=rates[:, :, :1]).square()
        weight = (exposure[:, None, None] * measured).expand_as(rates)
        inputs = torch.cat((torch.log1p(rates.clamp(min=0)), torch.log1p(difference), weight), dim=1)
        levels = self.network.encode(inputs)
        coarse = levels[-1]
        share = F.adaptive_avg_pool3d(measured, (1, *coarse.shape[3:]))
        share = share / share.mean(dim=(3, 4), keepdim=True).clamp(min=1e-6)
        pooled = (coarse.float() * share).mean(dim=(2, 3, 4))
        points = measured.sum(dim=(1, 2, 3, 4)).clamp(min=1)
        statistics = torch.stack(  # of the measured points alone
            (
                (0.5 * difference.sum(dim=(1, 2, 3, 4)) / points / rates.shape[2] + 1e-6).log10(),
                (rates.sum(dim=(1, 2, 3, 4)) / points / rates.shape[2] + 1e-6).log10(),
                measured.mean(dim=(1, 2, 3, 4)).clamp(min=1e-6).log10(),
            ),
            dim=1,
        )
        summary = torch.cat((pooled, torch.log1p(pooled.abs()), statistics), dim=1)
        eta = 0.5 * statistics[:, 0] + self.scalar(summary)[:, 0]
        fine = self.network.decode(levels)
        shape = self.map(torch.cat((fine.mean(dim=2), fine.amax(dim=2)), dim=1))
        shape = F.interpolate(shape.float(), size=exposure.shape[1:], mode="bilinear", align_corners=False)[:, 0]
        # a longer dwell averages noise away; what is left to the network is the rest
        noise = eta[:, None, None] + shape - 0.5 * exposure.clamp(min=1e-6).log10()
        return eta, torch.where(exposure > 0, noise, torch.inf)
