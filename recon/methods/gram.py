"""Convolutional Gram operator: least squares with a prior of smooth surfaces, on the light cone."""

from typing import Annotated

import torch
from pydantic import Field
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.errors import InvalidSettings
from nlos.recon.inverted_in_bands import inverted_in_bands
from nlos.recon.method import MethodResult
from nlos.recon.physics import prepare, seen_in
from nlos.recon.physics_settings import LightConeSettings
from nlos.recon.transport.conventions import depths_m
from nlos.recon.transport.falloff import Falloff
from nlos.recon.transport.light_cone import LightConeConvolution
from nlos.recon.transport.resampling import LightConeResampling


class Settings(LightConeSettings):
    """Settings of the Gram operator."""

    flatness: Annotated[float, Field(gt=0, le=10)] = 0.1
    """How much of the prior falls on the albedo itself beside its gradient."""


class Gram(nn.Module):
    """(B, C, T, H, W) counts -> (B, C, D, H, W), not below 0. Source: Ahn et al., ICCV 2019."""

    takes_response = True

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__()
        if settings.conventions == "authors":
            raise InvalidSettings("gram knows only the physical conventions; remove conventions=authors")
        self.settings, self.time = settings, time
        self.depths_m = depths_m(time, "physical")
        self.falloff = Falloff(time, settings.falloff)
        self.resample = LightConeResampling(time)
        self.cone = LightConeConvolution(wall, time, tile=settings.tile)

    def forward(
        self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None, response: torch.Tensor | None = None
    ) -> MethodResult[torch.Tensor]:
        """The volume, its front view and its depth map."""
        return seen_in(self.volume(counts, exposure_s, response), self.depths_m)

    def volume(
        self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None, response: torch.Tensor | None = None
    ) -> torch.Tensor:
        """The smooth least-squares albedo; a `response` (B, K) is part of the operator."""
        signal, snr = prepare(counts, exposure_s, self.settings, self.time, self.falloff)
        level = torch.as_tensor(snr, dtype=signal.dtype).expand(len(signal))
        if response is None:
            solved = self.inverse(self.resample(signal), level)
        else:
            level = self.settings.snr_where_told(level)
            solved = inverted_in_bands(signal, level, response, self.time, self.resample, self.cone, self.inverse)
        return self.resample.adjoint(solved).clamp_(min=0)

    def inverse(self, light: torch.Tensor, snr: torch.Tensor, spectrum: torch.Tensor | None = None) -> torch.Tensor:
        """The least-squares albedo on the light cone."""
        return self.cone.gram_inverse(light, snr, self.settings.flatness, spectrum)


def build(settings: AnySettings, wall: WallGrid, time: TimeAxis) -> Gram:
    """The operator for one geometry."""
    assert isinstance(settings, Settings)
    return Gram(settings, wall, time)
