"""Arrays of few points seen on a finer grid, whose other cells nobody measured.

A network that learned on 32 and 64 points a side, whole and thinned out, knows 8 x 8 points among 56 x 56 and not
8 x 8 pixels, each as wide as a part of the scene. So each point becomes the middle of an odd number of cells a side,
and the picture of those cells is averaged over the array's own.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from nlos.acquisition.wall import WallGrid
from nlos.recon.method import MethodResult, sure

FEW = 28  # points a side; of 32 a picture is as good either way
DARK = 1e-6  # of brightness: the least that a cell's depth counts by
CELLS = 48  # a side, at least: between the 32 and 64 points that networks learned on


@dataclass(frozen=True)
class FinerGrid:
    """The grid of `wall`, and `times` finer in y and x, odd numbers; (1, 1) leaves everything as it is."""

    wall: WallGrid
    times: tuple[int, int] = (1, 1)

    @classmethod
    def of_few(cls, wall: WallGrid) -> "FinerGrid":
        """As fine as arrays of few points are seen on."""
        down, across = (_times(points) for points in (wall.rows, wall.cols))
        return cls(WallGrid(wall.width_m, wall.height_m, wall.rows * down, wall.cols * across), (down, across))

    def spread(self, counts: Tensor, exposure: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Counts (B, 1, T, H, W) and exposure (B, H, W) or None of the array, on the finer grid, exposure 0 between."""
        if self.times == (1, 1):
            return counts, exposure
        even = counts.new_ones((len(counts), *counts.shape[-2:])) if exposure is None else exposure
        return self._between(counts), self._between(even)

    def gathered(self, made: MethodResult[Tensor]) -> MethodResult[Tensor]:
        """What was seen on the finer grid, of the array's own pixels: means over cells, those of depths and their
        bounds by brightness; the brightest pixel is as bright as the brightest cell."""
        if self.times == (1, 1):
            return made
        mean = self._mean(made.albedo)
        scale = _brightest(made.albedo) / _brightest(mean).clamp(min=1e-12)
        light = made.albedo.clamp(min=DARK)

        def deep(depth_m: Tensor) -> Tensor:
            there = torch.isfinite(depth_m)
            weight = self._mean(light * there)
            return torch.where(weight > 0, self._mean(torch.where(there, depth_m, 0) * light) / weight, torch.nan)

        made_of = {"albedo": lambda x: self._mean(x) * scale, "depth": deep, "seen": self._mean}
        known: Mapping[str, Tensor] | None = getattr(made, "intervals", None)
        if known is not None:
            known = {name: made_of[name.partition("_")[0]](x) for name, x in known.items()}
        volume = None if made.volume is None else self._mean(made.volume) * scale[:, None]
        return sure(MethodResult(mean * scale, deep(made.depth_m), volume), known)

    def _between(self, x: Tensor) -> Tensor:
        """(..., H, W) in the middle of each pixel's cells, 0 in the others."""
        down, across = self.times
        spread = x.new_zeros((*x.shape[:-2], self.wall.rows, self.wall.cols))
        spread[..., down // 2 :: down, across // 2 :: across] = x
        return spread

    def _mean(self, x: Tensor) -> Tensor:
        """(B, H, W) or (B, D, H, W) over each pixel's cells."""
        return F.avg_pool2d(x, self.times)


def _times(points: int) -> int:
    """The least odd number that brings so many points to `CELLS`; 1 where they are not few."""
    times = -(-CELLS // points)
    return 1 if points >= FEW else times + 1 - times % 2


def _brightest(x: Tensor) -> Tensor:
    return x.amax(dim=(1, 2), keepdim=True)
