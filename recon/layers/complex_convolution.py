"""Complex convolution over a spectrum, run as one real convolution on stacked real and imaginary parts."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class ComplexConv3d(nn.Module):
    """Conv_C(h) = (M*x - N*y) + i(M*y + N*x) for h = x + iy and the kernel W = M + iN (NANO, section IV-B2).

    (B, C_in, D, H, W) complex -> (B, C_out, D, H, W) complex; with a stride of 2 onto the frequencies `first_kept`,
    `first_kept` + 2, ... of each axis, zero frequency (index n // 2 of the shifted layout) among them. Without `bias`
    the map is linear over the complex numbers. `gain` scales the initial kernel.
    """

    def __init__(
        self,
        channels_in: int,
        channels_out: int,
        kernel: int = 3,
        stride: int = 1,
        gain: float = 1.0,
        bias: complex | None = None,
    ):
        super().__init__()
        shape = (channels_out, channels_in, kernel, kernel, kernel)
        deviation = gain / (2 * channels_in * kernel**3) ** 0.5
        self.real = nn.Parameter(torch.randn(shape) * deviation)
        self.imag = nn.Parameter(torch.randn(shape) * deviation)
        self.bias: nn.Parameter | None = None
        if bias is not None:
            start = torch.tensor([bias.real, bias.imag])
            self.bias = nn.Parameter(start[:, None].repeat(1, channels_out).flatten())
        self.stride = stride

    def forward(self, h: Tensor) -> Tensor:
        top = torch.cat((self.real, -self.imag), dim=1)
        bottom = torch.cat((self.imag, self.real), dim=1)
        weight = torch.cat((top, bottom), dim=0)  # [[M, -N], [N, M]]
        stacked = torch.cat((h.real, h.imag), dim=1)  # (B, 2 C_in, D, H, W)
        half = self.real.shape[-1] // 2
        if self.stride == 2:
            sides = [(half - first_kept(n), half) for n in reversed(h.shape[2:])]
            out = F.conv3d(F.pad(stacked, [n for side in sides for n in side]), weight, self.bias, stride=2).float()
        else:
            out = F.conv3d(stacked, weight, self.bias, padding=half).float()
        x, y = out.chunk(2, dim=1)
        return torch.complex(x.contiguous(), y.contiguous())


def first_kept(size: int) -> int:
    """The first of every second index 0 .. `size` - 1 among which is `size` // 2, where zero frequency lies."""
    return size // 2 % 2
