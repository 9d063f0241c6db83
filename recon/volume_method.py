"""What the physics methods share that make a volume and may be told the instrument's response."""

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from nlos.recon.method import MethodResult
from nlos.recon.physics import seen_in


class VolumeMethod(nn.Module, ABC):
    """(B, C, T, H, W) counts -> what one sees of a volume (B, C, D, H, W) at `depths_m`: `volume` is what differs."""

    takes_response = True
    fading_per_m: npt.NDArray[np.float64] | None = None
    """(D,): what the logarithm of a surface's brightness falls by a metre of depth; None where it does not fall."""
    depths_m: npt.NDArray[np.float64]

    def forward(
        self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None, response: torch.Tensor | None = None
    ) -> MethodResult[torch.Tensor]:
        """The volume, its front view and its depth map."""
        return seen_in(self.volume(counts, exposure_s, response), self.depths_m, self.fading_per_m)

    @abstractmethod
    def volume(
        self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None, response: torch.Tensor | None = None
    ) -> torch.Tensor:
        """(B, C, D, H, W), not below 0; `response` (B, K): shares a bin, K odd, the middle on time."""
