"""A multilayer perceptron on the channels of a complex field, the same at every frequency."""

from torch import Tensor, nn

from nlos.recon.layers.complex_activation import ActivationName, complex_activation
from nlos.recon.layers.complex_convolution import ComplexConv3d


class ComplexMLP(nn.Module):
    """h -> W2 sigma_C(W1 h): complex 1x1x1 convolutions (the projection B_p of NANO, eq. 9, and the end of SFE).

    (B, C_in, D, H, W) complex -> (B, C_out, D, H, W) complex.
    """

    def __init__(
        self,
        channels_in: int,
        hidden: int,
        channels_out: int,
        activation: ActivationName = "modrelu",
        gain: float = 1.0,
    ):
        super().__init__()
        self.layers = nn.Sequential(
            ComplexConv3d(channels_in, hidden, kernel=1),
            complex_activation(activation, hidden),
            ComplexConv3d(hidden, channels_out, kernel=1, gain=gain),
        )

    def forward(self, h: Tensor) -> Tensor:
        out: Tensor = self.layers(h)
        return out
