"""A picture held against the light that it was made from, and corrected where the two disagree.

Data consistency as in unrolled reconstruction (Adler and Oektem 2018, learned primal-dual), but on the surface: the
picture is rendered at every measured point, what is left of the light is gathered along each pixel's paths, and a small
network turns that into a change of brightness and depth. It sees the scan's own points and times, which the operator's
coarser grid does not hold.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.counts import exposed
from nlos.recon.layers.light_left_over import AROUND, CHANNELS, LightLeftOver
from nlos.recon.layers.placed import placed
from nlos.recon.layers.unet import UNet

WIDTHS = (32, 48, 64)
ALBEDO, ASKED, DEPTH, CHANGE = (CHANNELS.index(name) for name in ("albedo", "asked", "depth", "change"))
NEARER = 0.25  # pixels' pitches of depth for an output of 1
BRIGHTNESS = slice(0, 2)  # of the network's outputs: added, and a share of what the light asks for; the third is depth


class Correction(nn.Module):
    """What the light left over, (B, C, H, W), makes of a picture: brightness, and by how many wall widths it is deeper,
    (B, H, W) each.

    What was dark does not outshine its surroundings: light that the model of a surface does not explain, as of a second
    bounce, else ends in single bright pixels. Untrained it leaves the picture as it is.
    """

    def __init__(self) -> None:
        super().__init__()
        self.network = UNet(2, len(CHANNELS), 3, WIDTHS)
        nn.init.zeros_(self.network.head.weight)
        nn.init.zeros_(self.network.head.bias)  # type: ignore[arg-type]

    def forward(self, found: Tensor) -> tuple[Tensor, Tensor]:
        added, share, deeper = self.network(found).float().unbind(dim=1)
        before = found[:, ALBEDO]
        albedo = (before + added + share * found[:, CHANGE]).clamp(min=0)
        brightest = F.max_pool2d(before, 2 * AROUND + 1, 1, AROUND)
        return torch.minimum(albedo, brightest), deeper * (NEARER / found.shape[-1])


class Refined(NamedTuple):
    """Pictures (B, H, W), depths (B, H, W) in wall widths, and what their light said of them before, by `CHANNELS`,
    (B, C, H, W): all 0 of one that stays as it was."""

    albedo: Tensor
    depth: Tensor
    found: Tensor


def as_it_was(albedo: Tensor, depth: Tensor) -> Refined:
    """A picture that nothing was asked of."""
    return Refined(albedo, depth, albedo.new_zeros(len(albedo), len(CHANNELS), *albedo.shape[1:]))


class Refinement:
    """`correction` for scans of one wall and time axis."""

    def __init__(self, correction: Correction, wall: WallGrid, time: TimeAxis, falloff: float):
        self.correction = correction
        self.left_over = LightLeftOver(wall, time, falloff)

    @torch.no_grad()
    def __call__(
        self, counts: Tensor, exposure: Tensor | None, response: Tensor | None, albedo: Tensor, depth: Tensor
    ) -> Refined:
        """counts (B, 1, T, H, W), exposure (B, H, W), 0 = not measured, None for an even one, response (B, K) or None,
        picture (B, H, W) over its brightest point, depth (B, H, W) in wall widths -> picture, depth and what the
        light said."""
        relative = exposed(counts, exposure).relative
        correction, refined = placed(self.correction, counts.device), as_it_was(albedo, depth)
        pictures, depths = [], []
        for k in range(len(counts)):
            told = None if response is None else response[k]
            found = self.left_over(counts[k, 0], relative[k], albedo[k].clamp(0, 1), depth[k], told)
            if found is None:
                pictures.append(albedo[k])
                depths.append(depth[k])
                continue
            picture, deeper = (x[0] for x in correction(found[None]))
            pictures.append(picture)
            depths.append(torch.where(found[ASKED] > 0, found[DEPTH] + 0.5 + deeper, depth[k]))
            refined.found[k] = found
        return Refined(torch.stack(pictures), torch.stack(depths), refined.found)
