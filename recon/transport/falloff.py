"""Undoes the fading of light with distance: every time bin times (its distance / the farthest)^exponent."""

import numpy as np
import torch
from torch import nn

from acquisition.transient import TimeAxis
from recon.transport.conventions import Conventions, check_supported, depths_m, range_m


class Falloff(nn.Module):
    """Diagonal in time, hence its own adjoint. Exponent 4 for diffuse, 2 for retroreflective surfaces.

    (B, C, T, H, W) -> the same. Source: O'Toole et al. 2018, eq. 1.
    """

    weight: torch.Tensor

    def __init__(self, time: TimeAxis, exponent: float = 4.0, conventions: Conventions = "physical") -> None:
        super().__init__()
        check_supported(time, conventions)
        if conventions == "authors":
            relative = np.linspace(0.0, 1.0, time.bins)
        else:
            relative = np.maximum(depths_m(time, conventions), 0.0) / range_m(time, conventions)
        weight = torch.from_numpy(relative**exponent)
        self.register_buffer("weight", weight[:, None, None], persistent=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """x with its falloff removed."""
        return x * self.weight.to(x.dtype)

    def adjoint(self, y: torch.Tensor) -> torch.Tensor:
        """The same: the operator is diagonal and real."""
        return self.forward(y)
