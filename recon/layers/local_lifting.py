"""Local transient lifting: 3x3 patches of the wall, each read along time by one shared 1D U-Net."""

import torch.nn.functional as F
from torch import Tensor, nn

from nlos.recon.layers.residual_block import ResidualBlock
from nlos.recon.layers.small_convolution import SmallConv3d
from nlos.recon.layers.unet import UNet


class LocalLifting(nn.Module):
    """F_l: (B, C, T, H, W) -> (B, 4C, T, ceil(H/2), ceil(W/2)) (NANO, section IV-B1, "L-TL").

    Residual convolutions halve time and expand to 4C channels; 3x3 patches at stride 2 (36C channels each, about
    (H/2 - 1)(W/2 - 1) of them) go through a 1D U-Net over time, are folded back (overlaps averaged), returned to T
    bins, and refined by a residual MLP. `hidden` is the width of the 1D U-Net, which reads all 36C channels.
    """

    def __init__(self, channels: int = 1, hidden: tuple[int, ...] = (16, 24)):
        super().__init__()
        wide = 4 * channels
        self.expand = SmallConv3d(channels, wide, 3, stride=(2, 1, 1), padding=1)
        self.residual = ResidualBlock(3, wide)
        self.temporal = UNet(1, 9 * wide, 9 * wide, hidden)
        self.mlp = nn.Sequential(nn.Conv3d(wide, 2 * wide, 1), nn.GELU(), nn.Conv3d(2 * wide, wide, 1))

    def forward(self, tau: Tensor) -> Tensor:
        batch, _, bins, height, width = tau.shape
        x = self.residual(self.expand(tau))  # (B, 4C, T/2, H, W)
        _, wide, short, _, _ = x.shape
        frames = x.transpose(1, 2).reshape(batch * short, wide, height, width)
        # one row and column of padding gives every patch centre its 3x3 patch, at odd sizes too
        patches = F.unfold(frames, 3, padding=1, stride=2)  # (B T/2, 36C, N)
        count = patches.shape[-1]
        series = patches.view(batch, short, 9 * wide, count).permute(0, 3, 2, 1).reshape(batch * count, 9 * wide, short)
        series = series + self.temporal(series)
        patches = series.view(batch, count, 9 * wide, short).permute(0, 3, 2, 1).reshape(batch * short, -1, count)
        folded = F.fold(patches, (height, width), 3, padding=1, stride=2)
        overlap = F.fold(
            F.unfold(frames.new_ones(1, 1, height, width), 3, padding=1, stride=2), (height, width), 3, 1, 1, 2
        )
        folded = (folded / overlap).view(batch, short, wide, height, width).transpose(1, 2)
        half = (bins, (height + 1) // 2, (width + 1) // 2)
        lifted = F.interpolate(folded, size=half, mode="trilinear", align_corners=False)
        out: Tensor = lifted + self.mlp(lifted)
        return out
