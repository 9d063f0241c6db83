"""Lifting in the measurement space: an MLP, the global or the local path, or both fused; then to object space."""

from typing import Literal

import torch
from torch import Tensor, nn

from nlos.recon.layers.global_lifting import GlobalLifting
from nlos.recon.layers.local_lifting import LocalLifting
from nlos.recon.layers.small_convolution import SmallConv3d

LiftingName = Literal["none", "mlp", "global", "local", "both"]


class TransientLifting(nn.Module):
    """F_st = Conv(F_l, F_g): (B, 1, T, H, W) -> (B, 4, T, ceil(H/2), ceil(W/2)) (NANO, section IV-B1).

    `kind` leaves one path out, or puts a pointwise MLP in their place ("mlp"), as the paper's ablations do.
    """

    def __init__(self, kind: Literal["mlp", "global", "local", "both"]):
        super().__init__()
        self.paths = nn.ModuleList()
        if kind == "mlp":
            pointwise = (nn.Conv3d(1, 8, 1), nn.GELU(), nn.Conv3d(8, 4, 1), nn.AvgPool3d((1, 2, 2), ceil_mode=True))
            self.paths.append(nn.Sequential(*pointwise))
        if kind in ("global", "both"):
            self.paths.append(GlobalLifting())
        if kind in ("local", "both"):
            self.paths.append(LocalLifting())
        self.fuse = SmallConv3d(4 * len(self.paths), 4, 3, padding=1)

    def forward(self, tau: Tensor) -> Tensor:
        out: Tensor = self.fuse(torch.cat([path(tau) for path in self.paths], dim=1))
        return out
