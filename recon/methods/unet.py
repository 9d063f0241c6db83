"""A plain 3D U-Net over Wiener volumes with attention along depth: the simplest learned method, to compare with."""

from typing import Self

import torch
import torch.nn.functional as F
from pydantic import model_validator
from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as BaseSettings
from nlos.recon.layers.renderer import where_seen
from nlos.recon.layers.unet import UNet
from nlos.recon.layers.volume_projection import AttentionProjection
from nlos.recon.layers.wiener_features import SNR_FACTORS, WienerFeatures
from nlos.recon.method import MethodResult
from nlos.recon.weights.files import with_weights


class Settings(BaseSettings):
    """Shape of the network."""

    weights: str | None = "unet"
    """Weights file, or a name of those that ship; none for an untrained network."""
    widths: tuple[int, ...] = (16, 32, 48)
    """Channels of the 3D network, one entry per scale."""
    features: int = 8
    """Feature channels handed to the 2D network."""
    finish_widths: tuple[int, ...] = (32, 64, 128)
    """Channels of the 2D network, one entry per scale."""
    core_points: int = 32
    """Lateral size of the 3D network's grid, a fixed pitch on the wall whatever the scan's."""
    farthest: float = 2.0
    """How deep the network looks, in wall widths."""

    @model_validator(mode="after")
    def _every_scale_has_points(self) -> Self:
        if not (self.widths and self.finish_widths):
            raise ValueError("widths and finish_widths need an entry for every scale, one at least")
        least = 2 ** (len(self.widths) - 1)
        if self.core_points < least:
            raise ValueError(
                f"{len(self.widths)} widths halve core_points, {self.core_points}, {len(self.widths) - 1} times: take "
                f"{least} or more, or fewer widths"
            )
        return self


def build(settings: Settings, wall: WallGrid, time_axis: TimeAxis) -> nn.Module:
    """The network for this wall and time axis; raises WeightsError if the weights are not of this shape."""
    return with_weights(UNetMethod(settings, wall, time_axis), settings.weights)


class UNetMethod(nn.Module):
    """counts (B, 1, T, H, W), exposure (B, H, W) -> albedo (B, H, W), depth_m (B, H, W), volume (B, D, H, W)."""

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__()
        volumes = len(SNR_FACTORS)
        self.physics = WienerFeatures(wall, time, farthest=settings.farthest)
        self.unit_m = wall.width_m / 2
        self.core_points = settings.core_points
        self.core = UNet(3, 2 * volumes, 1 + settings.features, settings.widths)
        nn.init.normal_(self.core.head.weight, std=0.05)
        self.projection = AttentionProjection(volumes, settings.features, 1, settings.finish_widths)

    @property
    def depths_m(self) -> Tensor:
        """Planes of the volume, (D,)."""
        return self.physics.light_cone.depths_m

    def forward(self, counts: Tensor, exposure: Tensor | None = None) -> MethodResult[Tensor]:
        seen = self.physics(counts, exposure)
        depths = seen.depths_m / self.unit_m
        size = (max(1, len(depths) // 2), self.core_points, self.core_points)
        mean, highest = F.adaptive_avg_pool3d(seen.volumes, size), F.adaptive_max_pool3d(seen.volumes, size)
        out = self.core(torch.cat((mean, highest), dim=1))
        result = self.projection(out[:, 0], out[:, 1:], seen.volumes, seen.counted.measured[:, None], depths)
        depth_m = where_seen(result.albedo, result.depth * self.unit_m, self.training)
        return MethodResult(result.albedo, depth_m, result.volume)
