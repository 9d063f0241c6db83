"""Filtered back-projection: every count spread over the sphere it may have come from, then sharpened.

In light-cone space the spheres are cones and spreading is the adjoint of the light-cone convolution. Its transfer
function H falls as one over the frequency along v, so conj(H) times the frequency squared is the inverse: the filter
is the negative second derivative along v, of a Gaussian (Velten et al., Nature Communications 3, 2012, along depth).
"""

import numpy as np
import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport.conventions import Conventions
from nlos.recon.transport.light_cone import LightConeConvolution
from nlos.recon.transport.resampling import LightConeResampling


class BackProjection(nn.Module):
    """(B, C, T, H, W) -> (B, C, D, H, W), one plane a bin.

    `sharpen_cells` is the Gaussian's sigma in cells of the light cone; 0 leaves the filter away.
    """

    def __init__(
        self,
        wall: WallGrid,
        time: TimeAxis,
        sharpen_cells: float = 0.0,
        conventions: Conventions = "physical",
        tile: int | None = None,
    ) -> None:
        super().__init__()
        self.resample = LightConeResampling(time, conventions)
        self.cone = LightConeConvolution(wall, time, conventions, tile)
        self.gain: torch.Tensor | None = None
        if sharpen_cells > 0:
            radians = 2 * np.pi * np.arange(self.cone.padded[0] // 2 + 1) / self.cone.padded[0]  # a cell
            self.gain = torch.from_numpy(radians**2 * np.exp(-0.5 * (radians * sharpen_cells) ** 2))

    def forward(self, transient: torch.Tensor) -> torch.Tensor:
        """The sharpened back-projection."""
        return self.resample.adjoint(self.cone.adjoint(self.resample(transient), self.gain))

    def adjoint(self, volume: torch.Tensor) -> torch.Tensor:
        """The transpose: a sharpened volume's projection on the wall."""
        return self.resample.adjoint(self.cone(self.resample(volume), self.gain))
