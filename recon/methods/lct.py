"""Light-cone transform: the exact inverse for diffuse or retroreflective scenes, by one 3D deconvolution."""

import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.light_cone_method import LightConeMethod
from nlos.recon.transport.light_cone import Snr
from nlos.recon.without_torch.lct import Settings


class LightConeTransform(LightConeMethod):
    """(B, C, T, H, W) counts -> (B, C, D, H, W) albedo, one plane a bin. Source: O'Toole et al., Nature 2018."""

    def solved(self, signal: torch.Tensor, snr: Snr, response: torch.Tensor | None) -> torch.Tensor:
        """The Wiener inverse; a response is inverted with the light cone."""
        return self.inverted(signal, snr, response, self.cone.wiener)


def build(settings: AnySettings, wall: WallGrid, time: TimeAxis) -> LightConeTransform:
    """The transform for one geometry."""
    assert isinstance(settings, Settings)
    return LightConeTransform(settings, wall, time)
