"""The light cone inside every network: light over time in, albedo over depth out, regularised by an snr."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport.light_cone import LightConeConvolution
from nlos.recon.transport.resampling import LightConeResampling

if TYPE_CHECKING:
    from nlos.recon.layers.told_response import Told

QUANTILE = 0.98


class LightConeInverse(nn.Module):
    """R_z^-1, the Wiener inverse of H, and R_t (O'Toole et al., Nature 2018), for one wall and time axis.

    (B, C, T, H, W) -> the same, a plane a bin; differentiable in the light and, without a response, in the snr.
    """

    def __init__(self, wall: WallGrid, time: TimeAxis, tile: int | None = None) -> None:
        super().__init__()
        self.time = time
        self.resampling = LightConeResampling(time)
        self.cone = LightConeConvolution(wall, time, tile=tile)

    def forward(self, light: Tensor, snr: Tensor, spectra: Tensor | None = None) -> Tensor:
        """`snr` (B,) or (B, V): of one channel are made as many volumes. `spectra` (B, V, F): those of a response."""
        return self.over_depth(self.solved(self.on_cone(light), snr, spectra))

    def on_cone(self, light: Tensor) -> Tensor:
        """R_t: over bins of t -> over cells of t^2, (B, C, cells, H, W)."""
        squared: Tensor = self.resampling(light)
        return squared

    def solved(self, on_cone: Tensor, snr: Tensor, spectra: Tensor | None = None) -> Tensor:
        """Over cells of t^2 -> over cells of z^2, (B, V, cells, H, W)."""
        if snr.ndim == 2 and on_cone.shape[1] < snr.shape[1]:
            if spectra is None and not torch.is_grad_enabled():
                return self.cone.wiener_of_each(on_cone.float(), snr)
            on_cone = on_cone.repeat(1, snr.shape[1], 1, 1, 1)
        return self.cone.wiener(on_cone, snr, spectra)

    def over_depth(self, solved: Tensor) -> Tensor:
        """R_z^-1: over cells of z^2 -> over bins of depth."""
        return self.resampling.adjoint(solved)

    def spectra(self, response: "Told") -> Tensor:
        """Of a response, along the squares of time, one a band, (B, BANDS, F)."""
        return response.spectra(self.time, self.resampling.cells, self.cone.padded[0])


def undone(relative: Tensor, exponent: Tensor) -> Tensor:
    """What undoes the falloff: the distance of every bin, (T,), to the power of (B,) -> (B, 1, T, 1, 1)."""
    return (relative[None] ** exponent[:, None])[:, None, :, None, None]


def brightest(volumes: Tensor) -> Tensor:
    """How bright the brightest surfaces of (B, V, D, H, W) are, (B, V): a quantile of the maximum projection."""
    return volumes.amax(dim=2).flatten(2).quantile(QUANTILE, dim=2)
