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
ALBEDO_UNIT = 0.05  # of the brightest point
LEVEL = 0.95  # of the quantile that each side of an interval is
LARGEST = 6.0  # of the logarithm of a side over its unit
BACKGROUND = 0.25  # weight of brightness where no surface is
ALBEDO, DEPTH = NAMES.index("albedo"), NAMES.index("depth")


@dataclass(frozen=True)
class RawIntervals:
    """Before calibration, (B, H, W) each: what the picture says, how far the truth may lie below and above it, in its
    units and wall widths, and the logit of a surface being there."""

    albedo: Tensor
    depth: Tensor
    darker: Tensor
    brighter: Tensor
    nearer: Tensor
    farther: Tensor
    seen: Tensor


class IntervalHead(nn.Module):
    """(B, C, H, W) of `evidence` -> the distances of the 5 % and 95 % quantiles of brightness and depth from what the
    picture says, and whether a surface is there.

    An interval always holds the picture's own value, so that its width is no less than the error that is expected.
    Beside each pixel the network reads the means over what is bright: some scans are worse than others as a whole.
    """

    def __init__(self) -> None:
        super().__init__()
        self.network = UNet(2, 2 * len(NAMES), OUTPUTS, WIDTHS)
        nn.init.zeros_(self.network.head.weight)
        self.network.head.bias = nn.Parameter(torch.tensor([0.0, 0.0, 0.0, 0.0, -1.0]))

    def forward(self, evidence: Tensor) -> RawIntervals:
        weight = evidence[:, ALBEDO : ALBEDO + 1] + 1e-3
        whole = (evidence * weight).sum(dim=(2, 3), keepdim=True) / weight.sum(dim=(2, 3), keepdim=True)
        out = self.network(torch.cat((evidence, whole.expand_as(evidence)), dim=1)).float()
        sides = out[:, :4].clamp(-LARGEST, LARGEST).exp()
        darker, brighter = (ALBEDO_UNIT * sides[:, :2]).unbind(dim=1)
        nearer, farther = (DEPTH_UNIT * sides[:, 2:]).unbind(dim=1)
        albedo, depth = evidence[:, ALBEDO], evidence[:, DEPTH] + 0.5
        return RawIntervals(albedo, depth, darker, brighter, nearer, farther, out[:, 4])

    def loss(self, evidence: Tensor, intensity: Tensor, depth: Tensor, there: Tensor) -> Tensor:
        """Pinball losses of all four sides, of brightness (less so where nothing is `there`) and depth, and the cross
        entropy of `there`; every argument (B, H, W), every scan counting alike."""
        made = self(evidence)
        error = intensity - made.albedo
        albedo = _side(-error, made.darker, ALBEDO_UNIT) + _side(error, made.brighter, ALBEDO_UNIT)
        error = depth - made.depth
        depths = _side(-error, made.nearer, DEPTH_UNIT) + _side(error, made.farther, DEPTH_UNIT)
        surface = there.sum(dim=(1, 2)).clamp(min=1)
        on_surface = ((albedo + depths) * there).sum(dim=(1, 2)) / surface
        entropy = F.binary_cross_entropy_with_logits(made.seen, there)
        return on_surface.mean() + BACKGROUND * albedo.mean() + entropy


def _side(beyond: Tensor, side: Tensor, unit: float) -> Tensor:
    """How badly `side` serves as the quantile of `beyond`; compared as logarithms, which leaves quantiles where they
    are, so that the few largest errors do not decide alone."""
    return pinball(_compressed(beyond / unit) - _compressed(side / unit), LEVEL)


def _compressed(x: Tensor) -> Tensor:
    return x.sign() * torch.log1p(x.abs())


def pinball(error: Tensor, level: float) -> Tensor:
    """The loss whose minimum is the quantile of that level."""
    return torch.maximum(level * error, (level - 1) * error)
