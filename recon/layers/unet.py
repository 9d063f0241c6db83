"""A residual U-Net in one, two or three dimensions, for any size: what is odd is restored by interpolation."""

from collections.abc import Sequence
from itertools import pairwise

import torch.nn.functional as F
from torch import Tensor, nn

from nlos.recon.layers.residual_block import CONVOLUTIONS, ResidualBlock

INTERPOLATION = {1: "linear", 2: "bilinear", 3: "trilinear"}


class UNet(nn.Module):
    """(B, C_in, *size) -> (B, C_out, *ceil(size / stride)); one level per entry of `widths`, each half the last.

    `stride` is that of the first convolution, so the output may live on a coarser grid than the input.
    """

    def __init__(
        self,
        dimensions: int,
        channels_in: int,
        channels_out: int,
        widths: Sequence[int],
        stride: int | tuple[int, ...] = 1,
    ):
        super().__init__()
        convolution = CONVOLUTIONS[dimensions]
        self.mode = INTERPOLATION[dimensions]
        self.stem = convolution(channels_in, widths[0], 3, stride=stride, padding=1)  # type: ignore[arg-type]
        self.encoders = nn.ModuleList(ResidualBlock(dimensions, width) for width in widths)
        self.decoders = nn.ModuleList(ResidualBlock(dimensions, width) for width in widths[:-1])
        pairs = list(pairwise(widths))
        self.down = nn.ModuleList(convolution(fine, coarse, 3, stride=2, padding=1) for fine, coarse in pairs)
        self.up = nn.ModuleList(convolution(coarse, fine, 1) for fine, coarse in pairs)
        self.head = convolution(widths[0], channels_out, 1)

    def encode(self, x: Tensor) -> list[Tensor]:
        """The features of every level, finest first."""
        features = [self.encoders[0](self.stem(x))]
        for down, encoder in zip(self.down, list(self.encoders)[1:], strict=True):
            features.append(encoder(down(features[-1])))
        return features

    def decode(self, features: list[Tensor]) -> Tensor:
        """From the features of every level back to the finest one, (B, widths[0], ...)."""
        x = features[-1]
        for level in range(len(features) - 2, -1, -1):
            skip = features[level]
            x = F.interpolate(self.up[level](x), size=skip.shape[2:], mode=self.mode, align_corners=False)
            x = self.decoders[level](x + skip)
        return x

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.head(self.decode(self.encode(x)))
        return out
