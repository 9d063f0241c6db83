"""Complex convolution over a spectrum, run as one real convolution on stacked real and imaginary parts."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class ComplexConv3d(nn.Module):
    """Conv_C(h) = (M*x - N*y) + i(M*y + N*x) for h = x + iy and the kernel W = M + iN (NANO, section IV-B2).

    (B, C_in, D, H, W) complex -> (B, C_out, ceil(D/stride), ceil(H/stride), ceil(W/stride)) complex. No bias, so the
    map is linear over the complex numbers. `gain` scales the initial kernel.
    """

    def __init__(self, channels_in: int, channels_out: int, kernel: int = 3, stride: int = 1, gain: float = 1.0):
        super().__init__()
        shape = (channels_out, channels_in, kernel, kernel, kernel)
        deviation = gain / (2 * channels_in * kernel**3) ** 0.5
        self.real = nn.Parameter(torch.randn(shape) * deviation)
        self.imag = nn.Parameter(torch.randn(shape) * deviation)
        self.stride = stride

    def forward(self, h: Tensor) -> Tensor:
        top = torch.cat((self.real, -self.imag), dim=1)
        bottom = torch.cat((self.imag, self.real), dim=1)
        weight = torch.cat((top, bottom), dim=0)  # [[M, -N], [N, M]]
        stacked = torch.cat((h.real, h.imag), dim=1)  # (B, 2 C_in, D, H, W)
        out = F.conv3d(stacked, weight, stride=self.stride, padding=self.real.shape[-1] // 2).float()
        x, y = out.chunk(2, dim=1)
        return torch.complex(x.contiguous(), y.contiguous())
