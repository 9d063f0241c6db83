"""What the physics methods share that make a volume and may be told the instrument's response."""

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from nlos.recon.front_view import DepthBy, depth_map
from nlos.recon.method import MethodResult
from nlos.recon.physics import seen_in


class VolumeMethod(nn.Module, ABC):
    """(B, C, T, H, W) counts -> what one sees of a volume (B, C, D, H, W) at `depths_m`: `volume` is what differs."""

    takes_response = True
    depth_by: DepthBy = staticmethod(depth_map)
    """What finds the depths in a volume."""
    depths_m: npt.NDArray[np.float64]

    def forward(
        self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None, response: torch.Tensor | None = None
    ) -> MethodResult[torch.Tensor]:
        """The volume, its front view and its depth map."""
        return seen_in(self.volume(counts, exposure_s, response), self.depths_m, self.depth_by)

    @abstractmethod
    def volume(
        self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None, response: torch.Tensor | None = None
    ) -> torch.Tensor:
        """(B, C, D, H, W), not below 0; `response` (B, K): shares a bin, K odd, the middle on time."""
