"""The renderer of LFE and NLOST: from maxima and depths of feature volumes to one finished picture."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.recon.layers.transient_encoder import LeakyBlock

DIMMEST = 0.02  # of the brightest point; below it nothing is seen


class Renderer(nn.Module):
    """Maps (B, 2 C, h, w), C intensities before C depths -> one picture (B, H, W), as base plus learned residual.

    The base is a learned mixture of the first intensity and the first depth that begins as `base` (0 or 1) alone.
    `size` (H, W) may be any multiple of (h, w). Chen et al. 2020, section 4.3; `width` None is their width, 2 C.
    """

    def __init__(self, maps: int, base: int, width: int | None = None) -> None:
        super().__init__()
        self.channels = maps // 2
        width = width or maps
        self.mixture = nn.Conv2d(2, 1, 1, bias=False)
        with torch.no_grad():
            self.mixture.weight.zero_()[0, base] = 1
        self.coarse = nn.Sequential(nn.Conv2d(maps, width, 3, padding=1), *[LeakyBlock(2, width) for _ in range(2)])
        self.fine = nn.Sequential(
            nn.Conv2d(width + 1, 2 * width, 3, padding=1),
            *[LeakyBlock(2, 2 * width) for _ in range(2)],
            nn.Conv2d(2 * width, 1, 3, padding=1),
        )

    def forward(self, maps: Tensor, size: tuple[int, int]) -> Tensor:
        first = torch.stack((maps[:, 0], maps[:, self.channels]), dim=1)
        base = self.mixture(enlarged(first, size))
        features = enlarged(self.coarse(maps), size)
        picture: Tensor = (base + self.fine(torch.cat((features, base), dim=1)))[:, 0]
        return picture


def where_seen(albedo: Tensor, depth: Tensor, training: bool) -> Tensor:
    """Depth (B, H, W) with NaN where the picture is dark; all of it in training, where every pixel has a gradient."""
    if training:
        return depth
    return torch.where(albedo < DIMMEST * albedo.amax(dim=(1, 2), keepdim=True), torch.nan, depth)


def enlarged(x: Tensor, size: tuple[int, int]) -> Tensor:
    """Bilinear, pixel centres kept."""
    if tuple(x.shape[2:]) == size:
        return x
    return F.interpolate(x, size=size, mode="bilinear", align_corners=False)


def nearness(depths: Tensor, ends: tuple[float, float]) -> Tensor:
    """1 at the first of the two depths `ends`, 0 at the second, straight on beyond them."""
    return (ends[1] - depths) / (ends[1] - ends[0])


def depth_of(near: Tensor, ends: tuple[float, float]) -> Tensor:
    """The inverse of `nearness`."""
    return ends[1] - near * (ends[1] - ends[0])


def projected(volume: Tensor, sharpness: Tensor | None, place: Tensor) -> Tensor:
    """(B, C, D, H, W) -> (B, 2 C, H, W): the maximum along depth, and the `place` (D,) where it is.

    With `sharpness` (C,) both are attention-weighted means, softmax(sharpness x volume), which have a gradient along
    the whole ray; without it, the bare maximum, whose place has none.
    """
    if sharpness is None:
        highest, index = volume.max(dim=2)
        return torch.cat((highest, place[index]), dim=1)
    weight = torch.softmax(volume.float() * sharpness[None, :, None, None, None], dim=2)
    return torch.cat(((weight * volume).sum(dim=2), torch.einsum("bcdhw,d->bchw", weight, place)), dim=1)
