"""Intervals from NANO's evidence: a small network that says how far picture and depth may be off, and what is there."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.recon.layers.evidence import NAMES
from nlos.recon.layers.unet import UNet

WIDTHS = (24, 40, 64)
OUTPUTS = 5
DEPTH_UNIT = 0.0096  # wall widths: a slice of the Wiener volumes
ALBEDO, ALBEDO_SPREAD, DEPTH, DEPTH_SPREAD = (NAMES.index(name) for name in
                                              ("albedo", "albedo_spread", "depth", "depth_spread"))  # fmt: skip
NOISE, KEPT = NAMES.index("noise"), NAMES.index("kept")


@dataclass(frozen=True)
class RawIntervals:
    """Before calibration, (B, H, W) each: ends in the picture's units and wall widths, the scales that errors are
    counted in, and the logit of a surface being there."""

    albedo_low: Tensor
    albedo_high: Tensor
    depth_low: Tensor
    depth_high: Tensor
    albedo_scale: Tensor
    depth_scale: Tensor
    seen: Tensor


class IntervalHead(nn.Module):
    """(B, C, H, W) of `evidence` -> the 5 % and 95 % quantiles of brightness and depth, and whether a surface is there.

    Errors are counted in local scales, a share of the brightness and of a slice plus the spreads over mirror images, so
    that what is learned is a number of order 1 everywhere.
    """

    def __init__(self) -> None:
        super().__init__()
        self.network = UNet(2, len(NAMES), OUTPUTS, WIDTHS)
        nn.init.zeros_(self.network.head.weight)
        self.network.head.bias = nn.Parameter(torch.tensor([-1.0, 1.0, -1.0, 1.0, -1.0]))

    def forward(self, evidence: Tensor) -> RawIntervals:
        out = self.network(evidence).float()
        albedo, depth = evidence[:, ALBEDO], evidence[:, DEPTH] + 0.5
        albedo_scale = 0.02 + 0.2 * albedo + evidence[:, ALBEDO_SPREAD]
        depth_scale = DEPTH_UNIT * (0.3 + 4 * evidence[:, DEPTH_SPREAD])
        ends = [albedo + albedo_scale * out[:, 0], albedo + albedo_scale * out[:, 1]]
        ends += [depth + depth_scale * out[:, 2], depth + depth_scale * out[:, 3]]
        low_a, high_a = torch.minimum(ends[0], ends[1]), torch.maximum(ends[0], ends[1])
        low_z, high_z = torch.minimum(ends[2], ends[3]), torch.maximum(ends[2], ends[3])
        return RawIntervals(low_a, high_a, low_z, high_z, albedo_scale, depth_scale, out[:, 4])

    def loss(self, evidence: Tensor, intensity: Tensor, depth: Tensor, there: Tensor) -> Tensor:
        """Pinball losses at 5 and 95 % of brightness (everywhere) and depth (where `there`), in local scales, and the
        cross entropy of `there`; all (B, H, W)."""
        made = self(evidence)
        albedo = pinball((intensity - made.albedo_low) / made.albedo_scale, 0.05)
        albedo = albedo + pinball((intensity - made.albedo_high) / made.albedo_scale, 0.95)
        depths = pinball((depth - made.depth_low) / made.depth_scale, 0.05)
        depths = depths + pinball((depth - made.depth_high) / made.depth_scale, 0.95)
        surface = there.sum().clamp(min=1)
        entropy = F.binary_cross_entropy_with_logits(made.seen, there)
        on_surface = (albedo * there).sum() / surface + (depths * there).sum() / surface
        return 0.5 * albedo.mean() + on_surface + entropy


def pinball(error: Tensor, level: float) -> Tensor:
    """The loss whose minimum is the quantile of that level."""
    return torch.maximum(level * error, (level - 1) * error)
