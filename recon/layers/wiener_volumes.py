"""Noise-adapted Wiener volumes: what NANO's operator starts from.

Lengths are in wall widths: confocal imaging is similar under scaling, so one set of weights serves every wall.
"""

import math
from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.counts import added
from nlos.recon.layers.light_cone_inverse import LightConeInverse, undone
from nlos.recon.layers.noise_adapted import BY_NOISE_LEVEL, DIFFUSE
from nlos.recon.layers.operator_grid import to_grid
from nlos.recon.layers.rates import Rates
from nlos.recon.layers.told_response import BANDS, MIDDLE, Told
from nlos.recon.transport.response_bands import knots, windows

FINEST_BIN = 0.0049  # depth of a time bin in wall widths up to which neighbours are added
SLICE = 0.0096  # depth of a slice of the Wiener volumes, 19 mm behind a wall of 2 m
FARTHEST = 2.0
TRAINED_SLICES = 128
SNR_FACTORS = (0.4, 4.0)
VOLUMES = len(SNR_FACTORS) + 1
# Noise power of leaving gaps empty, over that of the signal, for each point not measured per point measured.
ALIASING = 0.5
SPECTRUM_BYTES = 1 << 29  # held of the light cone's spectrum at a time
SHARPENED = 0.5  # of a response's width is inverted: the network does the rest better (docs/decisions/185)


def rebinned_axis(wall: WallGrid, time: TimeAxis) -> tuple[int, TimeAxis]:
    """How many neighbouring bins are added, and the axis of the sums: none finer than FINEST_BIN unless the data's own
    is all there is, none beyond FARTHEST."""
    bin_depth = SPEED_OF_LIGHT_M_PER_S * time.bin_width_s / 2 / wall.longer_m
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
        unit_m = wall.longer_m
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
        plane = 8 * len(SNR_FACTORS) * wall.rows * wall.cols
        self.inverse = LightConeInverse(wall, self.time, tile=max(1, SPECTRUM_BYTES // plane))

    depths: Tensor
    relative: Tensor

    def rebin(self, counts: Tensor) -> Tensor:
        """(B, 1, T, H, W) -> (B, 1, bins, H, W): neighbouring bins added, what is too far cut."""
        return added(counts, self.factor, self.bins)

    def forward(self, rates: Rates, log_noise: Tensor, response: Told | None = None) -> Tensor:
        """rates of (B, 1, bins, H, W), log10 noise level (B,) -> (B, VOLUMES, slices, H, W)."""
        exponent = (BY_NOISE_LEVEL.exponent(log_noise) - (DIFFUSE - self.falloff)).clamp(min=0)
        weight = undone(self.relative, exponent)
        snr = BY_NOISE_LEVEL.snr(log_noise)
        snr_of = [snr * factor for factor in SNR_FACTORS]
        aliased = 1 / (1 / snr_of[-1] + ALIASING * (1 / rates.kept - 1))
        if response is not None:
            return self.sharpened(rates, weight, snr_of, aliased, response)
        volumes = self.slices_of(self.inverse(rates.net * weight, torch.stack(snr_of, dim=1)))
        if bool((rates.kept == 1).all()):
            return torch.cat((volumes, volumes[:, -1:]), dim=1)
        empty = self.slices_of(self.inverse(rates.unfilled * weight, aliased))
        return torch.cat((volumes, empty), dim=1)

    def sharpened(self, rates: Rates, weight: Tensor, snr_of: list[Tensor], aliased: Tensor, response: Told) -> Tensor:
        """The same three volumes, the response inverted with the light cone: the blurred one about the middle of the
        light alone, the sharp ones in bands of time."""
        spectra = self.inverse.spectra(response)
        weights = torch.from_numpy(np.stack([windows(knots_s, self.time) for knots_s in response.knots_s])).to(weight)

        def inverted(net: Tensor, snr: Tensor) -> Tensor:
            parts = self.inverse.solved(self.inverse.on_cone(net * weights[..., None, None]), snr, spectra)
            return self.slices_of(self.inverse.over_depth(parts.sum(dim=1, keepdim=True)))

        net = rates.net * weight
        blurred = self.slices_of(self.inverse(net, snr_of[0], spectra[:, MIDDLE]))
        sharp = inverted(net, snr_of[1])
        whole = bool((rates.kept == 1).all())
        empty = sharp if whole else inverted(rates.unfilled * weight, aliased)
        return torch.cat((blurred, sharp, empty), dim=1)

    def told(self, taps: Tensor, bin_width_s: float, net: Tensor) -> Told:
        """A response (B, K), narrowed to SHARPENED of its width, and BANDS times from the first light of `net` rates to
        the end of the axis, evenly over log t."""
        profiles = net.detach().mean(dim=(1, 3, 4)).cpu().numpy()
        return Told(taps.to(net), SHARPENED * bin_width_s, [knots(profile, self.time, BANDS) for profile in profiles])

    def slices_of(self, planes: Tensor) -> Tensor:
        """(B, V, bins, H, W), a plane a bin -> (B, V, slices, H, W)."""
        volume = planes[:, :, self.first :]
        size = (self.slices, *volume.shape[3:])
        if self.slices <= volume.shape[2]:
            return to_grid(volume, size)
        return F.interpolate(volume, size=size, mode="trilinear", align_corners=False)
