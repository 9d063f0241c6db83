"""The plain residual block of one, two or three dimensions that every U-Net here is built of."""

import torch.nn.functional as F
from torch import Tensor, nn

from nlos.recon.layers.small_convolution import SmallConv3d

CONVOLUTIONS: dict[int, type[nn.Conv1d] | type[nn.Conv2d] | type[nn.Conv3d]] = {
    1: nn.Conv1d,
    2: nn.Conv2d,
    3: SmallConv3d,
}


class ResidualBlock(nn.Module):
    """x -> x + conv(relu(conv(relu(x)))), kernels of 3, no normalisation; the second kernel starts small."""

    def __init__(self, dimensions: int, channels: int, gain: float = 0.3):
        super().__init__()
        convolution = CONVOLUTIONS[dimensions]
        self.first = convolution(channels, channels, 3, padding=1)
        self.second = convolution(channels, channels, 3, padding=1)
        for layer, scale in ((self.first, 1.0), (self.second, gain)):
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            layer.weight.data.mul_(scale)
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.second(F.relu(self.first(F.relu(x))))
        return x + out
