"""A multilayer perceptron on the channels of a complex field, the same at every frequency."""

import torch
from torch import Tensor, nn

from nlos.recon.layers.complex_activation import ActivationName, SplitActivation, complex_activation
from nlos.recon.layers.complex_convolution import ComplexConv3d

SMALL = 1e-3  # of tanh's argument, where it is the identity


class ComplexMLP(nn.Module):
    """h -> W2 sigma_C(W1 h): complex 1x1x1 convolutions (B_l and B_p of NANO, eq. 9, and the end of SFE).

    (B, C_in, D, H, W) complex -> (B, C_out, D, H, W) complex. `start_as_identity`: the first channel goes through
    unchanged, by two hidden channels of opposite sign, sigma(x) - sigma(-x); the other outputs begin at random.
    """

    def __init__(
        self,
        channels_in: int,
        hidden: int,
        channels_out: int,
        activation: ActivationName = "modrelu",
        gain: float = 1.0,
        start_as_identity: bool = False,
    ):
        super().__init__()
        self.layers = nn.Sequential(
            ComplexConv3d(channels_in, hidden, kernel=1),
            complex_activation(activation, hidden),
            ComplexConv3d(hidden, channels_out, kernel=1, gain=gain),
        )
        if start_as_identity:
            self._pass_the_first_channel_through(activation)

    @torch.no_grad()
    def _pass_the_first_channel_through(self, activation: ActivationName) -> None:
        first, middle, last = self.layers
        assert isinstance(first, ComplexConv3d)
        assert isinstance(last, ComplexConv3d)
        scale = SMALL if activation == "tanh" else 1.0
        slope = 2.0
        if isinstance(middle, SplitActivation) and isinstance(middle.sigma, nn.PReLU):
            slope = 1.0 + float(middle.sigma.weight)  # sigma(x) - sigma(-x) = (1 + a) x
        for part in (first.real[:2], first.imag[:2], last.real[:1], last.imag[:1]):
            part.zero_()
        first.real[:2, 0, 0, 0, 0] = torch.tensor([scale, -scale])
        last.real[0, :2, 0, 0, 0] = torch.tensor([1.0, -1.0]) / (slope * scale)

    def forward(self, h: Tensor) -> Tensor:
        out: Tensor = self.layers(h)
        return out
