"""Stochastic frequency encoding: random Gaussian mixtures of spectral channels at the coarsest scale."""

import torch
from torch import Tensor, nn

from nlos.recon.layers.complex_activation import ActivationName
from nlos.recon.layers.complex_mlp import ComplexMLP


class StochasticFrequencyEncoding(nn.Module):
    """u^ <- u^ + MLP_C(sum_l M_l x u^), M in R^(B x C) Gaussian, B the bandwidth (NANO, eq. 13, "SFE").

    The rows M_l mix channels of u^ into B features, and a complex MLP returns them to C channels. M is fixed and drawn
    from `seed`. `rank` < B factors it through that many channels (M = M_b M_a / sqrt(rank)): of the paper's 70 M
    parameters 66 M are here; this keeps the features and learns 2 C hidden weights each way. The last layer starts at
    zero. (B, C, D, H, W) complex -> the same shape.
    """

    mixing: Tensor

    def __init__(
        self, channels: int, bandwidth: int = 64, rank: int = 16, seed: int = 0, activation: ActivationName = "modrelu"
    ):
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        rank = min(rank, bandwidth)
        narrow = torch.randn(rank, channels, generator=generator) / channels**0.5
        wide = torch.randn(bandwidth, rank, generator=generator) / rank**0.5
        self.register_buffer("mixing", wide @ narrow, persistent=False)  # (bandwidth, C)
        self.mlp = ComplexMLP(bandwidth, rank, channels, activation, gain=0.0)

    def forward(self, u: Tensor) -> Tensor:
        out: Tensor = self.mlp(torch.einsum("lc,bcdhw->bldhw", self.mixing.to(u.dtype), u))
        return u + out


class DenseFrequencyEncoding(nn.Module):
    """S u^ = MLP_C(sum_l M_l x u^), M in R^(B x C) Gaussian and dense, B the bandwidth: eq. 13 of NANO as printed.

    The complex MLP has B hidden channels, so that its size grows with B^2, as the paper's 66 M parameters say. M is
    drawn once from `seed`; `redrawn`, anew at every step of training.
    (B, C, D, H, W) complex -> the same shape.
    """

    mixing: Tensor

    def __init__(
        self,
        channels: int,
        bandwidth: int,
        seed: int = 0,
        activation: ActivationName = "modrelu",
        redrawn: bool = False,
    ):
        super().__init__()
        self.redrawn = redrawn
        generator = torch.Generator().manual_seed(seed)
        mixing = torch.randn(bandwidth, channels, generator=generator) / channels**0.5
        self.register_buffer("mixing", mixing, persistent=False)  # (bandwidth, C)
        self.mlp = ComplexMLP(bandwidth, bandwidth, channels, activation, gain=0.3)

    def forward(self, u: Tensor) -> Tensor:
        mixing = self.mixing
        if self.redrawn and self.training:
            mixing = torch.randn_like(mixing) / mixing.shape[1] ** 0.5
        out: Tensor = self.mlp(torch.einsum("lc,bcdhw->bldhw", mixing.to(u.dtype), u))
        return out
