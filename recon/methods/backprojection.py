"""Filtered back-projection: spreads every count over the sphere it came from; the oldest method and a robust one."""

from typing import Annotated, ClassVar

import torch
from pydantic import Field
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.method import MethodResult
from nlos.recon.physics import prepare, seen_in
from nlos.recon.physics_settings import LightConeSettings
from nlos.recon.transport.backprojection import BackProjection
from nlos.recon.transport.conventions import depths_m
from nlos.recon.transport.falloff import Falloff


class Settings(LightConeSettings):
    """Settings of filtered back-projection. It has no inverse filter: `snr` changes nothing."""

    has_inverse_filter: ClassVar[bool] = False
    cubes: ClassVar[float] = 4.3

    sharpen_cells: Annotated[float, Field(ge=0, le=100)] = 2.0
    """Sigma of the sharpening filter, in cells of the light cone; 0 for none."""


class Filtered(nn.Module):
    """(B, C, T, H, W) counts -> (B, C, D, H, W), not below 0. Source: Velten et al., Nature Communications 3, 2012."""

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__()
        self.settings, self.time = settings, time
        self.depths_m = depths_m(time, settings.conventions)
        self.falloff = Falloff(time, settings.falloff, settings.conventions)
        self.project = BackProjection(wall, time, settings.sharpen_cells, settings.conventions, settings.tile)

    def forward(self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None) -> MethodResult[torch.Tensor]:
        """The volume, its front view and its depth map."""
        return seen_in(self.volume(counts, exposure_s), self.depths_m)

    def volume(self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None) -> torch.Tensor:
        """The sharpened back-projection."""
        signal, _ = prepare(counts, exposure_s, self.settings, self.time, self.falloff)
        volume: torch.Tensor = self.project(signal)
        return volume.clamp_(min=0)


def build(settings: AnySettings, wall: WallGrid, time: TimeAxis) -> Filtered:
    """The back-projection for one geometry."""
    assert isinstance(settings, Settings)
    return Filtered(settings, wall, time)
