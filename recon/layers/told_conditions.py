"""What NANO's operator is told of a scan beside its volumes: how noisy it is, and where it can be trusted."""

import torch
from torch import Tensor

from nlos.recon.layers.rates import Rates


def conditions(log_noise: Tensor, rates: Rates) -> Tensor:
    """eta as the multipliers see it, (B, 3): noise level, background share, kept share, each of order 1."""
    background = rates.background.clamp(min=1e-3).log10().clamp(-2.5, 1.5)
    return torch.stack((log_noise.clamp(-2.2, 0.2) + 1, background + 1, rates.kept.log2() / 2), dim=1)


def confidence(log_noise: Tensor, noise_map: Tensor, exposure: Tensor) -> Tensor:
    """(B, 2, H, W): exposure, and the mean noise over that of each wall point; both 0 where nothing was measured."""
    sure = 10 ** (log_noise[:, None, None] - noise_map)
    return torch.stack((exposure.clamp(max=4), sure.clamp(max=3)), dim=1)
