"""What the light cone makes of rates: fields over the squares of time and depth, where transport is a convolution."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.counts import added
from nlos.recon.layers.light_cone_inverse import LightConeInverse, undone
from nlos.recon.layers.noise_adapted import BY_NOISE_LEVEL
from nlos.recon.layers.wiener_volumes import SLICE, rebinned_axis


class LightConeFields(nn.Module):
    """R_t, R_z and the regularised inverse of H (NANO, eqs. 3 to 6) for one wall and time axis.

    Bins are added up to the depth of a slice, SLICE wall widths, and cut where `rebinned_axis` cuts. Falloff and snr of
    the inverse follow the noise level, as sigma^2 / gamma^2 of eq. 6 does.
    """

    depths: Tensor  # (bins,) in wall widths
    relative: Tensor

    def __init__(self, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__()
        self.wall, self.unit_m = wall, wall.longer_m
        self.rebinning, fine = rebinned_axis(wall, time)
        self.fine = fine
        bin_depth = SPEED_OF_LIGHT_M_PER_S * fine.bin_width_s / 2 / self.unit_m
        self.together = max(1, round(SLICE / bin_depth))
        self.bins = -(-fine.bins // self.together)
        self.time = replace(fine, bins=self.bins, bin_width_s=fine.bin_width_s * self.together)
        centres = self.time.centres_s() * (SPEED_OF_LIGHT_M_PER_S / 2 / self.unit_m)
        relative = np.maximum(centres, 0) / centres[-1]
        self.register_buffer("depths", torch.from_numpy(centres).float(), persistent=False)
        self.register_buffer("relative", torch.from_numpy(relative).float(), persistent=False)
        self.light_cone = LightConeInverse(wall, self.time)

    def rebin(self, counts: Tensor) -> Tensor:
        """(B, 1, T, H, W) -> (B, 1, fine bins, H, W), what noise estimation reads."""
        return added(counts, self.rebinning, self.fine.bins)

    def slices(self, rates: Tensor) -> Tensor:
        """(B, 1, fine bins, H, W) -> mean rates (B, 1, bins, H, W)."""
        return added(rates, self.together, self.bins) / self.together

    def squared(self, rates: Tensor, log_noise: Tensor) -> Tensor:
        """R_t: (B, C, bins, h, w), falloff undone, over cells of t^2, (B, C, cells, h, w)."""
        weight = undone(self.relative, BY_NOISE_LEVEL.exponent(log_noise))
        return self.light_cone.on_cone(rates.float() * weight)

    def inverse(self, light: Tensor, log_noise: Tensor) -> Tensor:
        """The solution of eq. 6 over cells of z^2, (B, 1, cells, H, W)."""
        return self.light_cone.solved(light, BY_NOISE_LEVEL.snr(log_noise))

    def adjoint(self, light: Tensor) -> Tensor:
        """H* of what was measured, (B, 1, cells, H, W)."""
        return self.light_cone.cone.adjoint(light)

    def metric(self, u: Tensor) -> Tensor:
        """R_z^-1: (B, C, cells, h, w) over z^2 -> (B, C, bins, h, w) at `depths`."""
        return self.light_cone.over_depth(u)
