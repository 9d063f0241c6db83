"""The transient encoder of LFE and NLOST: a learned average beside learned features, both on a coarser grid."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.recon.layers.residual_block import CONVOLUTIONS
from nlos.recon.layers.small_convolution import SmallConv3d

Stride = tuple[int, int, int]
SLOPE = 0.2


class LeakyBlock(nn.Module):
    """x -> leaky(x + conv(leaky(conv(x)))), kernels of 3; the residual block of LFE."""

    def __init__(self, dimensions: int, channels: int) -> None:
        super().__init__()
        convolution = CONVOLUTIONS[dimensions]
        self.first = convolution(channels, channels, 3, padding=1)
        self.second = convolution(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return F.leaky_relu(x + self.second(F.leaky_relu(self.first(x), SLOPE)), SLOPE)


class LearnedAverage(nn.Module):
    """A single learned 3x3x3 kernel that begins as the mean of each stride-sized cell, so that it adds no shift."""

    def __init__(self, channels_in: int, channels_out: int, stride: Stride) -> None:
        super().__init__()
        self.convolution = SmallConv3d(channels_in, channels_out, 3, stride=stride, padding=1, bias=False)
        with torch.no_grad():
            kernel = torch.zeros(3, 3, 3)
            taps = tuple(slice(1, 1 + step) for step in stride)
            kernel[taps] = 1.0
            self.convolution.weight.copy_(kernel / kernel.sum() / channels_in)

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.convolution(x)
        return out


class TransientEncoder(nn.Module):
    """(B, N, T, H, W) -> (B, N + C, T / st, H / sh, W / sw): the average of each input first, then C features of all.

    Strides are 1 or 2. Chen et al. 2020, section 4.1, of one input; NLOST's stem is the same with C = 3.
    """

    def __init__(self, features: int, stride: Stride, blocks: int = 2, inputs: int = 1) -> None:
        super().__init__()
        self.average = LearnedAverage(1, 1, stride)
        self.stem = SmallConv3d(inputs, features, 3, stride=stride, padding=1)
        self.blocks = nn.Sequential(*[LeakyBlock(3, features) for _ in range(blocks)])

    def forward(self, x: Tensor) -> Tensor:
        averages = [self.average(one[:, None]) for one in x.unbind(dim=1)]
        return torch.cat((*averages, self.blocks(self.stem(x))), dim=1)
