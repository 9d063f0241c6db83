"""Learned feature embeddings (Chen et al., SIGGRAPH Asia 2020): encode the transient, invert the light cone, render.

Where a published choice costs quality it is behind `paper`: input and volumes scaled by minimum and maximum, a fixed
snr, the bare maximum along depth, narrow renderers, half the wall's resolution. Without it the physics layer takes its
falloff and snr from the counts, projection is by attention, and the wall keeps its resolution.
"""

from typing import Literal

from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as BaseSettings
from nlos.recon.layers.renderer import enlarged
from nlos.recon.method import MethodResult
from nlos.recon.rendered_method import RenderedMethod
from nlos.recon.weights.files import with_weights


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
    return with_weights(LearnedFeatureEmbeddings(settings, wall, time_axis), settings.weights)


class LearnedFeatureEmbeddings(RenderedMethod):
    """counts (B, 1, T, H, W), exposure (B, H, W) -> albedo (B, H, W), depth_m (B, H, W), volume (B, D, H, W)."""

    nearness_ends = (0.12951, 0.89698)
    paper_scale = (2.0, -1.0)

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__(wall, time, settings.features, settings.lateral_stride, settings.farthest, settings.paper)
        self.intensity, self.depth = self.renderers(settings.renderer_width)

    def forward(self, counts: Tensor, exposure: Tensor | None = None) -> MethodResult[Tensor]:
        seen, volume = self.encoded(counts, exposure)
        albedo, depth_m, size = self.rendered(seen, volume)
        rows, cols = counts.shape[3:]
        return MethodResult(albedo, depth_m, enlarged(volume[:, 0], size)[:, :, :rows, :cols])
