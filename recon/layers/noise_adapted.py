"""Falloff exponent and snr of the light cone's inverse, by how noisy a measurement is."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

DIFFUSE = 4.0
"""Exponent with which the light of diffuse surfaces falls off."""


@dataclass(frozen=True)
class NoiseAdapted:
    """What was best at some values of a figure of noise; between them it is interpolated, beyond them constant."""

    knots: tuple[float, ...]
    exponents: tuple[float, ...]  # of diffuse surfaces
    log_snrs: tuple[float, ...]  # log10

    def exponent(self, noise: Tensor) -> Tensor:
        """Of the falloff, how much to undo, (B,)."""
        return piecewise(noise, self.knots, self.exponents)

    def snr(self, noise: Tensor) -> Tensor:
        """Of the Wiener inverse, (B,)."""
        return 10 ** piecewise(noise, self.knots, self.log_snrs)


BY_NOISE_LEVEL = NoiseAdapted(
    (-1.83, -1.53, -1.13, -0.83, -0.53, -0.33), (4.0, 3.5, 3.0, 2.4, 2.0, 1.6), (0.8, 0.4, -0.4, -0.8, -1.2, -1.6)
)
"""By log10 of the noise level (`noise_level.py`), of scenes on 64 x 64 points."""
BY_COUNTS = NoiseAdapted((1.2, 1.9, 2.5, 3.9), (2.0, 2.7, 3.0, 4.0), (-1.0, -0.9, -0.5, 0.3))
"""By log10 of the counts a point, less where few were measured (`Counted.level`), on simulated scenes."""


def piecewise(x: Tensor, knots: tuple[float, ...], values: tuple[float, ...]) -> Tensor:
    """Linear interpolation of `values` at `knots`, constant beyond them."""
    result = torch.full_like(x, values[0])
    for (left, right), (a, b) in zip(pairwise(knots), pairwise(values), strict=True):
        result = result + (b - a) * ((x - left) / (right - left)).clamp(0, 1)
    return result
