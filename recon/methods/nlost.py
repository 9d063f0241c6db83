"""NLOST (Li et al., CVPR 2023): encoded transients, the light cone, then local and global attention, and rendering.

Where a published choice costs quality it is behind `paper`: input and volumes scaled by minimum and maximum, a fixed
snr, the bare maximum along depth, the cross decoder's doubled result. Attention runs through PyTorch's
memory-efficient kernel in either case, and any size is taken.
"""

from typing import Any, Literal

import torch
import torch.nn.functional as F
import torch.utils.checkpoint
from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as BaseSettings
from nlos.recon.layers.space_depth_attention import CrossDecoder, GlobalEncoder, LocalEncoder
from nlos.recon.layers.transient_encoder import LeakyBlock, LearnedAverage
from nlos.recon.method import MethodResult
from nlos.recon.rendered_method import RenderedMethod
from nlos.recon.weights.files import with_weights

DEPTH_STRIDE = 16
STEM_FEATURES = 3


class Settings(BaseSettings):
    """Shape of the network."""

    weights: str | None = "nlost"
    """Weights file, or a name of those that ship; none for an untrained network."""
    channels: int = 32
    """Feature channels of the attention."""
    heads: int = 4
    """Attention heads."""
    window: int = 16
    """Side of the windows of local attention, in pixels."""
    lateral_stride: Literal[1, 2] = 2
    """2 halves the wall's resolution inside the network."""
    renderer_width: int = 24
    """Channels of the rendering networks."""
    farthest: float = 2.0
    """How deep the network looks, in wall widths."""
    checkpointing: bool = False
    """Training: compute activations again on the way back; less memory, more time."""
    paper: bool = False
    """The published network to the letter; weights of their own are needed."""


def build(settings: Settings, wall: WallGrid, time_axis: TimeAxis) -> nn.Module:
    """The network for this wall and time axis; raises WeightsError if the weights are not of this shape."""
    return with_weights(Nlost(settings, wall, time_axis), settings.weights)


class MultiScale(nn.Module):
    """(B, C, D, H, W) -> (B, 32, D / 2, H, W): four convolutions, plain and dilated, in two orders, side by side."""

    def __init__(self, channels_in: int, channels_out: int) -> None:
        super().__init__()
        quarter = channels_out // 4
        self.plain = nn.Conv3d(channels_in, quarter, 3, stride=(2, 1, 1), padding=1)
        self.wide = nn.Conv3d(channels_in, quarter, 3, stride=(2, 1, 1), padding=2, dilation=2)
        self.wide_plain = nn.Conv3d(quarter, quarter, 3, padding=1)
        self.plain_wide = nn.Conv3d(quarter, quarter, 3, padding=2, dilation=2)
        for layer in (self.plain, self.wide, self.wide_plain, self.plain_wide):
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")

    def forward(self, x: Tensor) -> Tensor:
        plain, wide = F.relu(self.plain(x)), F.relu(self.wide(x))
        return torch.cat((plain, wide, F.relu(self.wide_plain(wide)), F.relu(self.plain_wide(plain))), dim=1)


class DepthUpsampling(nn.Module):
    """(B, C, D, H, W) -> (B, C, 8 D, H, W) by three transposed convolutions along depth."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        shape: dict[str, Any] = {"kernel_size": (6, 3, 3), "stride": (2, 1, 1), "padding": (2, 1, 1), "bias": False}
        self.first = nn.ConvTranspose3d(channels, channels // 2, **shape)
        self.middle = nn.ConvTranspose3d(channels // 2, channels // 4, **shape)
        self.last = nn.ConvTranspose3d(channels // 4, channels, **shape)
        nn.init.normal_(self.last.weight, std=1e-3)

    def forward(self, x: Tensor) -> Tensor:
        x = F.relu(self.middle(F.relu(self.first(x))))
        out: Tensor = self.last(x)
        return out


class Nlost(RenderedMethod):
    """counts (B, 1, T, H, W), exposure (B, H, W) -> albedo (B, H, W), depth_m (B, H, W), volume (B, D, H, W)."""

    nearness_ends = (0.13431, 0.88260)

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__(wall, time, STEM_FEATURES, settings.lateral_stride, settings.farthest, settings.paper)
        self.checkpointing = settings.checkpointing
        stem, channels = self.channels, settings.channels
        self.multi_scale = MultiScale(stem, channels)
        self.depth_average = LearnedAverage(channels, channels, (2, 1, 1))
        self.depth_down = nn.Sequential(
            nn.Conv3d(channels, channels, 3, stride=(2, 1, 1), padding=1), *[LeakyBlock(3, channels) for _ in range(2)]
        )
        self.embedding = nn.Sequential(
            nn.Conv3d(channels, channels, 5, stride=(2, 1, 1), padding=2),
            nn.ReLU(),
            nn.Conv3d(channels, channels, 5, stride=(2, 1, 1), padding=2),
            nn.ReLU(),
            nn.Conv3d(channels, channels, 1),
            nn.ReLU(),
        )
        self.lateral_down = nn.Conv3d(channels, channels, 5, stride=(1, 2, 2), padding=2)
        self.local_position = nn.Conv3d(channels, channels, 3, padding=1)
        self.global_position = nn.Conv3d(channels, channels, 3, padding=1)
        self.local_encoder = LocalEncoder(channels, settings.heads, settings.window)
        self.global_encoder = GlobalEncoder(channels, settings.heads)
        self.lateral_up = nn.ConvTranspose3d(channels, channels, (3, 6, 6), (1, 2, 2), (1, 2, 2), bias=False)
        self.to_local = CrossDecoder(channels, 2 * settings.heads, doubled=settings.paper)
        self.to_global = CrossDecoder(channels, 2 * settings.heads, doubled=settings.paper)
        self.local_up, self.global_up = DepthUpsampling(channels), DepthUpsampling(channels)
        self.fusion = nn.Conv3d(3 * channels, channels, 3, padding=1)
        self.head = nn.Conv3d(channels, stem, 3, padding=1)
        self.intensity, self.depth = self.renderers(settings.renderer_width)

    @property
    def depths_m(self) -> Tensor:
        """Planes of the volume, (D,): pairs of the light cone's slices."""
        slices = self.light_cone.depths_m
        return slices[: len(slices) // 2 * 2].reshape(-1, 2).mean(dim=1)

    def forward(self, counts: Tensor, exposure: Tensor | None = None) -> MethodResult[Tensor]:
        seen, volume = self.encoded(counts, exposure)
        refined = self.refine(volume)  # the head begins as a small correction of the light cone's own volumes
        albedo, depth_m, size = self.rendered(seen, refined)
        rows, cols = counts.shape[3:]
        planes = self.depths_m
        fine = F.interpolate(refined[:, :1].float(), size=(len(planes), *size), mode="trilinear", align_corners=False)
        return MethodResult(albedo, depth_m, fine[:, 0, :, :rows, :cols])

    def refine(self, volume: Tensor) -> Tensor:
        """(B, 4, D, H, W) -> the same, through the two branches of attention."""
        depth, rows, cols = volume.shape[2:]
        lateral = (-rows % 2, -cols % 2)
        x = F.pad(volume, (0, lateral[1], 0, lateral[0], 0, -depth % DEPTH_STRIDE))
        features = self.multi_scale(x)
        signal = self.depth_average(features) + self.depth_down(features)
        tokens = self.embedding(signal)
        near, far = tokens, F.relu(self.lateral_down(tokens))
        near = near + self.local_position(near)
        far = far + self.global_position(far)
        near, far = self._attend(near, far)
        fused = self.fusion(torch.cat((features, self.global_up(far), self.local_up(near)), dim=1))
        out: Tensor = self.head(F.leaky_relu(fused, 0.2))
        if not self.paper:
            out = out + F.avg_pool3d(x, (2, 1, 1))
        return out[:, :, : max(1, depth // 2), :rows, :cols]

    def _attend(self, near: Tensor, far: Tensor) -> tuple[Tensor, Tensor]:
        def both(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
            a, b = self.local_encoder(a), F.relu(self.lateral_up(self.global_encoder(b)))
            return self.to_local(a, b), self.to_global(b, a)

        if self.checkpointing and self.training:
            result: tuple[Tensor, Tensor] = torch.utils.checkpoint.checkpoint(both, near, far, use_reentrant=False)
            return result
        return both(near, far)
