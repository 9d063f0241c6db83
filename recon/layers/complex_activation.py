"""Activations of complex features: on real and imaginary parts apart (the paper), or on the modulus alone."""

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

ActivationName = Literal["modrelu", "prelu", "tanh"]


class SplitActivation(nn.Module):
    """sigma_C(h) = sigma(Re h) + i sigma(Im h), sigma PReLU or Tanh, both 1-Lipschitz (NANO, section IV-B2).

    It does not commute with a phase, so it breaks the translation and flip symmetry of the volume behind the spectrum.
    """

    def __init__(self, kind: Literal["prelu", "tanh"] = "prelu"):
        super().__init__()
        self.sigma: nn.Module = nn.PReLU(init=0.25) if kind == "prelu" else nn.Tanh()

    def forward(self, h: Tensor) -> Tensor:
        real, imaginary = (self.sigma(part).to(part) for part in (h.real, h.imag))  # autocast makes halves of them
        return torch.complex(real, imaginary)


class ModReLU(nn.Module):
    """h -> h max(|h| + b, 0) / |h| with one b per channel; keeps translations and flips (arXiv:1511.06464)."""

    def __init__(self, channels: int):
        super().__init__()
        self.threshold = nn.Parameter(torch.zeros(channels))

    def forward(self, h: Tensor) -> Tensor:
        modulus = (h.real.square() + h.imag.square() + 1e-12).sqrt()
        threshold = self.threshold.view(1, -1, *[1] * (h.ndim - 2))
        return h * (F.relu(modulus + threshold) / modulus)


def complex_activation(name: ActivationName, channels: int) -> nn.Module:
    """The activation of that name for `channels` complex channels."""
    return ModReLU(channels) if name == "modrelu" else SplitActivation(name)
