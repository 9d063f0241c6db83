"""Light-cone transform: the exact inverse for diffuse or retroreflective scenes, by one 3D deconvolution."""

import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.inverted_in_bands import inverted_in_bands
from nlos.recon.method import MethodResult
from nlos.recon.physics import prepare, seen_in
from nlos.recon.plain.lct import Settings
from nlos.recon.transport.conventions import depths_m
from nlos.recon.transport.falloff import Falloff
from nlos.recon.transport.light_cone import LightConeConvolution
from nlos.recon.transport.resampling import LightConeResampling


class LightConeTransform(nn.Module):
    """(B, C, T, H, W) counts -> (B, C, D, H, W) albedo, one plane a bin. Source: O'Toole et al., Nature 2018."""

    takes_response = True

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__()
        self.settings, self.time = settings, time
        self.depths_m = depths_m(time, settings.conventions)
        self.falloff = Falloff(time, settings.falloff, settings.conventions)
        self.resample = LightConeResampling(time, settings.conventions)
        self.cone = LightConeConvolution(wall, time, settings.conventions, settings.tile)

    def forward(
        self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None, response: torch.Tensor | None = None
    ) -> MethodResult[torch.Tensor]:
        """The volume, its front view and its depth map."""
        return seen_in(self.volume(counts, exposure_s, response), self.depths_m)

    def volume(
        self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None, response: torch.Tensor | None = None
    ) -> torch.Tensor:
        """The albedo volume, not below 0; a `response` (B, K) is inverted with the light cone."""
        signal, snr = prepare(counts, exposure_s, self.settings, self.time, self.falloff)
        if response is None:
            solved = self.cone.wiener(self.resample(signal), snr)
        else:
            level = self.settings.snr_where_told(snr)
            solved = inverted_in_bands(signal, level, response, self.time, self.resample, self.cone, self.cone.wiener)
        return self.resample.adjoint(solved).clamp_(min=0)


def build(settings: AnySettings, wall: WallGrid, time: TimeAxis) -> LightConeTransform:
    """The transform for one geometry."""
    assert isinstance(settings, Settings)
    return LightConeTransform(settings, wall, time)
