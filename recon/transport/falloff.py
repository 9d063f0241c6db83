"""Undoes the fading of light with distance: every time bin times (its distance / the farthest)^exponent."""

import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.recon.transport.conventions import Conventions
from nlos.recon.transport.falloff_weights import relative_distance


class Falloff(nn.Module):
    """Diagonal in time, hence its own adjoint. Exponent 4 for diffuse, 2 for retroreflective surfaces.

    (B, C, T, H, W) -> the same. Source: O'Toole et al. 2018, eq. 1.
    """

    distance: torch.Tensor

    def __init__(self, time: TimeAxis, exponent: float = 4.0, conventions: Conventions = "physical") -> None:
        super().__init__()
        self.exponent = exponent
        relative = torch.from_numpy(relative_distance(time, conventions))
        self.register_buffer("distance", relative[:, None, None], persistent=False)

    def weights(self, undone: torch.Tensor | None = None) -> torch.Tensor:
        """(T, 1, 1); of the exponent only the part `undone` (B,) where given, then (B, 1, T, 1, 1)."""
        if undone is None:
            return self.distance**self.exponent
        return self.distance ** (self.exponent * undone.to(self.distance).view(-1, 1, 1, 1, 1))

    def forward(self, x: torch.Tensor, undone: torch.Tensor | None = None) -> torch.Tensor:
        """x with its falloff, or the part `undone` (B,) of it, removed."""
        return x * self.weights(undone).to(x.dtype)

    def adjoint(self, y: torch.Tensor, undone: torch.Tensor | None = None) -> torch.Tensor:
        """The same: the operator is diagonal and real."""
        return self.forward(y, undone)
