"""Learned feature embeddings (Chen et al., SIGGRAPH Asia 2020): encode the transient, invert the light cone, render.

Where a published choice costs quality it is behind `paper`: input and volumes scaled by minimum and maximum, a fixed
snr, the bare maximum along depth, narrow renderers, half the wall's resolution. Without it the physics layer takes its
falloff and snr from the counts, projection is by attention, and the wall keeps its resolution.
"""

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as BaseSettings
from nlos.recon.layers.light_cone_layer import LightConeLayer
from nlos.recon.layers.renderer import Renderer, depth_of, enlarged, nearness, projected, where_seen
from nlos.recon.layers.transient_encoder import Stride, TransientEncoder
from nlos.recon.layers.wiener_features import SNR_FACTORS, bins_together, counted, normalised, rebinned
from nlos.recon.method import MethodResult

PAPER_SNR = 0.1
TYPICAL_PULSE_BINS = 16
NEARNESS_ENDS = (0.12951, 0.89698)  # in wall widths: nearness 1 and 0, the first and last slice in training


class Settings(BaseSettings):
    """Shape of the network."""

    weights: str | None = "lfe"
    """Weights file, or a name of those that ship; none for an untrained network."""
    features: int = 3
    """Learned feature channels beside the average."""
    renderer_width: int = 24
    """Channels of the rendering networks."""
    lateral_stride: Literal[1, 2] = 1
    """2 halves the wall's resolution inside the network."""
    farthest: float = 2.0
    """How deep the network looks, in wall widths."""
    paper: bool = False
    """The published network to the letter; weights of their own are needed."""


def build(settings: Settings, wall: WallGrid, time_axis: TimeAxis) -> nn.Module:
    """The network for this wall and time axis; raises WeightsError if the weights are not of this shape."""
    from nlos.recon.weights.files import with_weights

    return with_weights(LearnedFeatureEmbeddings(settings, wall, time_axis), settings.weights)


class LearnedFeatureEmbeddings(nn.Module):
    """counts (B, 1, T, H, W), exposure (B, H, W) -> albedo (B, H, W), depth_m (B, H, W), volume (B, D, H, W)."""

    snr_factors: Tensor

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__()
        self.paper, self.width_m = settings.paper, wall.width_m
        self.together = bins_together(wall, time)
        coarse, stride = coarser(wall, rebinned(time, self.together), settings.lateral_stride)
        self.stride = stride
        self.encoder = TransientEncoder(settings.features, stride)
        self.light_cone = LightConeLayer(*coarse, farthest=settings.farthest)
        channels = settings.features + 1
        if not self.paper:
            factors = torch.tensor([SNR_FACTORS[k % 2] for k in range(channels)])
            self.register_buffer("snr_factors", factors, persistent=False)
            self.log_sharpness = nn.Parameter(torch.full((channels,), 2.5))
        width = None if self.paper else settings.renderer_width
        maps = 2 * channels if self.paper else 2 * channels + 2
        self.intensity = Renderer(maps, 0, width)
        self.depth = Renderer(maps, 1, width)

    @property
    def depths_m(self) -> Tensor:
        """Planes of the volume, (D,)."""
        return self.light_cone.depths_m

    def forward(self, counts: Tensor, exposure: Tensor | None = None) -> MethodResult[Tensor]:
        seen = counted(counts, exposure, self.together)
        rows, cols = counts.shape[3:]
        if self.paper:
            x = min_max(seen.rate) * 2 - 1
        else:
            x = seen.rate * (TYPICAL_PULSE_BINS / seen.net)[:, None, None, None, None]
        encoded = self.encoder(padded_to(x, self.stride))
        place = nearness(self.depths_m / self.width_m, NEARNESS_ENDS)
        ones = torch.ones_like(encoded[:, :, 0, 0, 0], dtype=torch.float32)
        if self.paper:
            volume = min_max(F.relu(self.light_cone(encoded, 4 * ones[:, 0], PAPER_SNR * ones)))
            maps = projected(volume, None, place)
        else:
            snr = seen.snr[:, None] * self.snr_factors * ones
            volume = normalised(F.relu(self.light_cone(encoded, seen.exponent, snr))).clamp(max=4)
            measured = F.interpolate(seen.measured[:, None], size=volume.shape[3:], mode="area")
            level = (0.25 * seen.level)[:, None, None, None].expand_as(measured)
            maps = with_context(projected(volume, self.log_sharpness.exp(), place), measured, level)
        size = (volume.shape[3] * self.stride[1], volume.shape[4] * self.stride[2])
        albedo = self.intensity(maps, size)[:, :rows, :cols]
        depth_m = self.width_m * depth_of(self.depth(maps, size)[:, :rows, :cols].float(), NEARNESS_ENDS)
        depth_m = where_seen(albedo, depth_m, self.training)
        return MethodResult(albedo, depth_m, enlarged(volume[:, 0], size)[:, :, :rows, :cols])


def coarser(wall: WallGrid, time: TimeAxis, lateral: int) -> tuple[tuple[WallGrid, TimeAxis], Stride]:
    """The grid after a stride of 2 in time and `lateral` in space, padded where it does not divide."""
    rows, cols, bins = (
        -(-count // step) for count, step in ((wall.rows, lateral), (wall.cols, lateral), (time.bins, 2))
    )
    grid = WallGrid(wall.width_m * cols * lateral / wall.cols, wall.height_m * rows * lateral / wall.rows, rows, cols)
    return (grid, TimeAxis(bins, 2 * time.bin_width_s, time.start_s)), (2, lateral, lateral)


def padded_to(x: Tensor, stride: Stride) -> Tensor:
    """Zeros after the end of each axis up to a multiple of the stride."""
    missing = [-size % step for size, step in zip(x.shape[2:], stride, strict=True)]
    return F.pad(x, (0, missing[2], 0, missing[1], 0, missing[0]))


def min_max(x: Tensor) -> Tensor:
    """Every channel of every sample scaled to [0, 1]."""
    low, high = x.amin(dim=(2, 3, 4), keepdim=True), x.amax(dim=(2, 3, 4), keepdim=True)
    return (x - low) / (high - low + 1e-15)


def with_context(maps: Tensor, *more: Tensor) -> Tensor:
    """Intensities and depths with one further map in each half, so that both keep their places."""
    intensities, depths = maps.chunk(2, dim=1)
    return torch.cat((intensities, more[0], depths, more[1]), dim=1)
