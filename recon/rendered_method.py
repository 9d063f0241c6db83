"""What LFE and NLOST share: transients encoded, the light cone inverted, pictures rendered from what comes out.

Where a published choice costs quality it is behind `paper`: input and volumes scaled by minimum and maximum, a fixed
snr, the bare maximum along depth, narrow renderers.
"""

from typing import ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.light_cone_layer import LightConeLayer
from nlos.recon.layers.renderer import Renderer, depth_of, nearness, projected, where_seen
from nlos.recon.layers.transient_encoder import Stride, TransientEncoder
from nlos.recon.layers.wiener_features import SNR_FACTORS, Counted, bins_together, counted, normalised, rebinned

PAPER_SNR = 0.1
TYPICAL_PULSE_BINS = 16


class RenderedMethod(nn.Module):
    """A method makes its own parts, then `intensity` and `depth` by `renderers`; its `forward` calls the other two."""

    nearness_ends: ClassVar[tuple[float, float]]
    """In wall widths: nearness 1 and 0, the first and last plane in training."""
    paper_scale: ClassVar[tuple[float, float]] = (1.0, 0.0)
    """Factor and offset of the published network's input, which is from 0 to 1."""
    inputs: ClassVar[int] = 1
    """Fields of rates that `shown` makes."""

    snr_factors: Tensor
    intensity: Renderer
    depth: Renderer

    def __init__(
        self, wall: WallGrid, time: TimeAxis, features: int, lateral_stride: int, farthest: float, paper: bool
    ) -> None:
        super().__init__()
        self.paper, self.width_m, self.channels = paper, wall.width_m, features + self.inputs
        self.together = bins_together(wall, time)
        coarse, self.stride = coarser(wall, rebinned(time, self.together), lateral_stride)
        self.encoder = TransientEncoder(features, self.stride, inputs=self.inputs)
        self.light_cone = LightConeLayer(*coarse, farthest=farthest)
        if not paper:
            factors = torch.tensor([SNR_FACTORS[k % 2] for k in range(self.channels)])
            self.register_buffer("snr_factors", factors, persistent=False)
            self.log_sharpness = nn.Parameter(torch.full((self.channels,), 2.5))

    def renderers(self, width: int) -> tuple[Renderer, Renderer]:
        """Of intensity and depth, made last so that a seed draws the weights in the order of the network."""
        maps, chosen = (2 * self.channels, None) if self.paper else (2 * self.channels + 2, width)
        return Renderer(maps, 0, chosen), Renderer(maps, 1, chosen)

    @property
    def depths_m(self) -> Tensor:
        """Planes of the volume, (D,)."""
        return self.light_cone.depths_m

    def encoded(self, counts: Tensor, exposure: Tensor | None) -> tuple[Counted, Tensor]:
        """What was counted, and the volumes that the light cone makes of the encoded channels, (B, C, D, H, W)."""
        seen = counted(counts, exposure, self.together)
        rates = self.shown(seen, counts, exposure)
        if self.paper:
            factor, offset = self.paper_scale
            x = min_max(rates) * factor + offset
        else:
            x = rates * (TYPICAL_PULSE_BINS / seen.net)[:, None, None, None, None]
        channels = self.encoder(padded_to(x, self.stride))
        ones = torch.ones_like(channels[:, :, 0, 0, 0], dtype=torch.float32)
        if self.paper:
            return seen, min_max(F.relu(self.light_cone(channels, 4 * ones[:, 0], PAPER_SNR * ones)))
        snr = seen.snr[:, None] * self.snr_factors * ones
        return seen, normalised(F.relu(self.light_cone(channels, seen.exponent, snr))).clamp(max=4)

    def shown(self, seen: Counted, counts: Tensor, exposure: Tensor | None) -> Tensor:
        """What is encoded, (B, inputs, T, H, W): the rates, gaps between the points left empty."""
        return seen.rate

    def rendered(self, seen: Counted, volume: Tensor) -> tuple[Tensor, Tensor, tuple[int, int]]:
        """Albedo and depth (B, H, W) of volumes (B, C, D, h, w), and the size before the cut to the wall's points."""
        rows, cols = seen.measured.shape[1:]
        place = nearness(self.depths_m / self.width_m, self.nearness_ends)
        if self.paper:
            maps = projected(volume, None, place)
        else:
            measured = F.interpolate(seen.measured[:, None], size=volume.shape[3:], mode="area")
            level = (0.25 * seen.level)[:, None, None, None].expand_as(measured)
            maps = with_context(projected(volume, self.log_sharpness.exp(), place), measured, level)
        size = (volume.shape[3] * self.stride[1], volume.shape[4] * self.stride[2])
        albedo = self.intensity(maps, size)[:, :rows, :cols]
        depth_m = self.width_m * depth_of(self.depth(maps, size)[:, :rows, :cols].float(), self.nearness_ends)
        return albedo, where_seen(albedo, depth_m, self.training), size


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
