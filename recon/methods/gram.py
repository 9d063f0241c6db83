"""Convolutional Gram operator: least squares with a prior of smooth surfaces, on the light cone."""

from typing import Annotated, ClassVar

import numpy as np
import torch
from pydantic import Field

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.errors import InvalidSettings
from nlos.recon.light_cone_method import LightConeMethod
from nlos.recon.physics_settings import LightConeSettings
from nlos.recon.transport.light_cone import Snr


class Settings(LightConeSettings):
    """Settings of the Gram operator."""

    told_cubes: ClassVar[float] = 2.1

    flatness: Annotated[float, Field(gt=0, le=10)] = 0.1
    """How much of the prior falls on the albedo itself beside its gradient."""


class Gram(LightConeMethod):
    """(B, C, T, H, W) counts -> (B, C, D, H, W), not below 0. Source: Ahn et al., ICCV 2019."""

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        if settings.conventions == "authors":
            raise InvalidSettings("gram knows only the physical conventions; remove conventions=authors")
        super().__init__(settings, wall, time)
        self.flatness = settings.flatness

    def solved(self, signal: torch.Tensor, snr: Snr, response: torch.Tensor | None) -> torch.Tensor:
        """The smooth least-squares albedo; a response is part of the operator."""
        along = np.sin(np.pi * np.arange(self.cone.padded[0] // 2 + 1) / self.cone.padded[0]) ** 2
        return self.inverted(signal, snr, response, self.inverse, self.flatness + along)

    def inverse(self, light: torch.Tensor, snr: Snr, spectrum: torch.Tensor | None = None) -> torch.Tensor:
        """The least-squares albedo of light on the cone."""
        level = torch.as_tensor(snr, dtype=light.dtype).expand(len(light))
        return self.cone.gram_inverse(light, level, self.flatness, spectrum)


def build(settings: AnySettings, wall: WallGrid, time: TimeAxis) -> Gram:
    """The operator for one geometry."""
    assert isinstance(settings, Settings)
    return Gram(settings, wall, time)
