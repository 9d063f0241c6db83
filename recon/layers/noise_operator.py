"""The noise level induced operator: how strongly each channel and frequency is damped, given the noise."""

from typing import Literal

import torch
from torch import Tensor, nn

from nlos.recon.layers.complex_activation import ActivationName, complex_activation
from nlos.recon.layers.complex_convolution import ComplexConv3d

Meeting = Literal["added", "concatenated"]
"""How eta^ and F^_st come into the operator together."""


class NoiseEmbedding(nn.Module):
    """eta^ = MLP(eta): (B, conditions) -> (B, C, 1, 1, 1) complex (NANO, eq. 11)."""

    def __init__(self, conditions: int, channels: int, hidden: int = 32):
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(conditions, hidden), nn.GELU(), nn.Linear(hidden, 2 * channels))

    def forward(self, eta: Tensor) -> Tensor:
        real, imag = self.mlp(eta).float().chunk(2, dim=1)
        return torch.complex(real, imag)[:, :, None, None, None]


class NoiseInducedOperator(nn.Module):
    """S u^ = NLO * u^ with NLO = Conv_C(sigma_C(Conv_C(eta^))), pointwise (NANO, section IV-B2, "NLO").

    Where there are lifted features F^_st (B, C, D, H, W), they condition it together with eta^ (B, C, 1, 1, 1), added
    to it or as channels beside it. Kernels of 1 unless given: what is convolved is constant over the spectrum but for
    F^_st. The last convolution starts at -1, so that the first update is u_g - u, as in the steepest descent of eq. 7.
    (B, C, D, H, W) complex -> the same shape; linear in u^.
    """

    def __init__(
        self, channels: int, activation: ActivationName = "modrelu", kernel: int = 1, meeting: Meeting = "added"
    ):
        super().__init__()
        self.meeting = meeting
        inputs = channels if meeting == "added" else 2 * channels
        self.modulation = nn.Sequential(
            ComplexConv3d(inputs, channels, kernel),
            complex_activation(activation, channels),
            ComplexConv3d(channels, channels, kernel, gain=0.1, bias=-1.0 + 0.0j),
        )

    def forward(self, u: Tensor, lifted: Tensor | None, embedding: Tensor) -> Tensor:
        return self.multiplier(lifted, embedding) * u

    def multiplier(self, lifted: Tensor | None, embedding: Tensor) -> Tensor:
        """NLO, (B, C, D, H, W), or (B, C, 1, 1, 1) where nothing is lifted."""
        if self.meeting == "concatenated":
            beside = torch.zeros_like(embedding) if lifted is None else lifted
            told = torch.cat((beside, embedding.expand(-1, -1, *beside.shape[2:])), dim=1)
        else:
            told = embedding if lifted is None else lifted + embedding
        out: Tensor = self.modulation(told)
        return out
