"""From a volume to a picture and a depth map: attention along depth or the bare maximum, then a 2D network."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.recon.layers.operator_grid import to_grid
from nlos.recon.layers.residual_block import ResidualBlock
from nlos.recon.layers.unet import UNet


@dataclass(frozen=True)
class Projection:
    """A picture in units of its brightest point, a depth map, and the volume they were taken from."""

    albedo: Tensor  # (B, H, W)
    depth: Tensor  # (B, H, W), in the unit of the depths given
    volume: Tensor  # (B, D, H, W)
    spreads: tuple[Tensor, Tensor] | None = None  # of picture and depth over mirror images of the wall, (B, H, W) each


def summed_along_depth(weight: Tensor, fields: Tensor) -> Tensor:
    """The weights (B, D, H, W) times `fields` (B, C, D, h, w), spread over H x W, summed along D: (B, C, H, W).

    One field after the other where nothing is learned: an einsum copies all of them into another order first.
    """
    size = weight.shape[2:]
    if not torch.is_grad_enabled():
        return torch.stack([(weight * _spread(field, size)).sum(dim=1) for field in fields.unbind(dim=1)], dim=1)
    spread = _spread(fields.flatten(1, 2), size).view(*fields.shape[:3], *size)
    return torch.einsum("bdhw,bfdhw->bfhw", weight, spread)


def _spread(x: Tensor, size: torch.Size) -> Tensor:
    """(B, D, h, w) -> (B, D, H, W)."""
    if x.shape[2:] == size:
        return x.float()
    return F.interpolate(x.float().contiguous(), size=size, mode="bilinear", align_corners=False)


class MaximumProjection(nn.Module):
    """I = Conv(max_z u), D = argmax_z u, Conv a few residual blocks (NANO, section IV-C, "VPL").

    u (B, D, h, w), depths (D,) -> Projection of `size` (H, W), by default (h, w): brightness by bilinear interpolation
    before the convolutions, depth that of the nearest. `finish` False leaves the bare maximum.
    """

    def __init__(self, channels: int = 32, blocks: int = 3, finish: bool = True):
        super().__init__()
        self.finish: nn.Module | None = None
        if finish:
            last = nn.Conv2d(channels, 1, 3, padding=1)
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)  # type: ignore[arg-type]
            body = [ResidualBlock(2, channels) for _ in range(blocks)]
            self.finish = nn.Sequential(nn.Conv2d(1, channels, 3, padding=1), *body, last)

    def forward(self, u: Tensor, depths: Tensor, size: tuple[int, int] | None = None) -> Projection:
        albedo, index = u.max(dim=1, keepdim=True)
        depth = depths[index]
        if size is not None and size != tuple(u.shape[2:]):
            albedo = F.interpolate(albedo, size=size, mode="bilinear", align_corners=False)
            depth = F.interpolate(depth, size=size, mode="nearest-exact")
        if self.finish is not None:
            albedo = albedo + self.finish(albedo).float()
        return Projection(albedo[:, 0], depth[:, 0], u)


class AttentionProjection(nn.Module):
    """The maximum made soft: attention softmax_z(logits + prior) reads volumes and depth, a 2D U-Net finishes.

    logits (B, d, h, w) and features (B, F, d, h, w) may live on a coarser grid; volumes (B, V, D, H, W) are the Wiener
    solutions, maps (B, M, H, W) any further pictures (exposure, noise). Picture = 0.8 x the first volume under the
    attention + the U-Net's residual; depth = attended depth + a residual in steps of the depth grid. With a `reach` the
    U-Net also sees the volumes so many slices before and behind the depth that is attended most: the pulse that a
    surface makes there at full resolution.
    """

    def __init__(
        self, volumes: int, features: int, maps: int, widths: tuple[int, ...] = (32, 64, 128), reach: int | None = None
    ):
        super().__init__()
        self.reach = reach
        self.prior = nn.Parameter(torch.tensor([4.0] + [0.0] * (volumes - 1)))
        self.sharpness = nn.Parameter(torch.tensor(0.0))
        profile = 0 if reach is None else volumes * (2 * reach + 1)
        self.finish = UNet(2, 2 * volumes + features + maps + 2 + profile, 2, widths)
        nn.init.zeros_(self.finish.head.weight)
        nn.init.zeros_(self.finish.head.bias)  # type: ignore[arg-type]

    def attention(self, logits: Tensor, volumes: Tensor) -> Tensor:
        """(B, D, H, W), one along depth."""
        fine = F.interpolate(logits[:, None].float(), size=volumes.shape[2:], mode="trilinear", align_corners=False)
        prior = torch.einsum("v,bvdhw->bdhw", self.prior, volumes)
        return torch.softmax(self.sharpness.exp() * (fine[:, 0] + prior), dim=1)

    def profile(self, weight: Tensor, volumes: Tensor) -> list[Tensor]:
        """Volumes (B, V, D, H, W) around the maximum of the attention (B, D, H, W): (B, V x slices, H, W), if any."""
        if self.reach is None:
            return []
        steps = torch.arange(-self.reach, self.reach + 1, device=weight.device)[:, None, None]
        slices = (weight.argmax(dim=1, keepdim=True) + steps).clamp(0, weight.shape[1] - 1)  # (B, K, H, W)
        index = slices[:, None].expand(-1, volumes.shape[1], -1, -1, -1)
        return [volumes.gather(2, index).flatten(1, 2)]

    def forward(self, logits: Tensor, features: Tensor, volumes: Tensor, maps: Tensor, depths: Tensor) -> Projection:
        weight = self.attention(logits, volumes)
        seen = summed_along_depth(weight, volumes)
        coarse = features.shape[2]
        # attention is averaged to the coarse depths instead of every feature being spread over the fine ones
        lateral = to_grid(weight[:, None], (coarse, *weight.shape[2:]))[:, 0] * (weight.shape[1] / coarse)
        read = summed_along_depth(lateral, features)
        depth = torch.einsum("bdhw,d->bhw", weight, depths)
        peak = weight.amax(dim=1)
        unit = depths[1] - depths[0]
        found = (seen, volumes.amax(dim=2), read, maps, depth[:, None], peak[:, None])
        inputs = torch.cat((*found, *self.profile(weight, volumes)), dim=1)
        residual = self.finish(inputs).float()
        albedo = 0.8 * seen[:, 0] + residual[:, 0]
        return Projection(albedo, depth + unit * residual[:, 1], weight * albedo.clamp(min=0)[:, None])
