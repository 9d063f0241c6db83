"""Blue noise: N pixels at random, but none close to another (best candidate, Mitchell 1991)."""

from typing import Literal

import numpy as np
from pydantic import Field

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.positions import Positions, pixels
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings

CANDIDATES = 24
"""Pixels drawn for each point; the one farthest from all points so far is taken."""


class BlueNoise(Settings):
    """`points` pixels at random, but evenly: none is close to another."""

    kind: Literal["blue_noise"] = "blue_noise"
    count: int = Field(ge=1, le=65536, alias="points")
    """How many pixels are measured."""
    seed: int = Field(default=0, ge=0)
    """Of the random numbers: the same seed gives the same points."""

    def points(self, wall: WallGrid) -> Positions:
        """In the order drawn, so that a shorter list is the beginning of a longer one with the same seed.

        Raises `PlanRefused` where the grid has fewer pixels.
        """
        if self.count > wall.rows * wall.cols:
            raise PlanRefused(f"{self.count} different pixels are more than {wall.rows} x {wall.cols}")
        draw = np.random.default_rng(self.seed)
        nearest = _Nearest(wall)
        chosen = np.empty((self.count, 2), dtype=np.int64)
        for taken in range(self.count):
            row, col = draw.integers(0, wall.rows, CANDIDATES), draw.integers(0, wall.cols, CANDIDATES)
            far = nearest.squared[row, col]
            best = int(np.argmax(far))
            if far[best] == 0.0:  # every candidate was taken before: any free pixel will do
                free = np.flatnonzero(nearest.squared)
                row[best], col[best] = np.divmod(free[int(draw.integers(len(free)))], wall.cols)
            chosen[taken] = row[best], col[best]
            nearest.add(int(row[best]), int(col[best]), taken + 1)
        return pixels(wall, chosen[:, 0], chosen[:, 1])


class _Nearest:
    """Squared distance in metres from every pixel to the nearest point chosen."""

    def __init__(self, wall: WallGrid) -> None:
        self.squared = np.full((wall.rows, wall.cols), np.inf)
        self._pitch_m = wall.height_m / wall.rows, wall.width_m / wall.cols
        self._reach_m = np.inf

    def add(self, row: int, col: int, count: int) -> None:
        """Only pixels within the largest distance so far can get a nearer point; it is looked up as points double."""
        reach = [int(min(self._reach_m / pitch, 1e6)) + 1 for pitch in self._pitch_m]
        top, left = max(row - reach[0], 0), max(col - reach[1], 0)
        part = self.squared[top : row + reach[0] + 1, left : col + reach[1] + 1]
        down_m = (np.arange(top, top + part.shape[0]) - row) * self._pitch_m[0]
        across_m = (np.arange(left, left + part.shape[1]) - col) * self._pitch_m[1]
        np.minimum(part, down_m[:, None] ** 2 + across_m**2, out=part)
        if count & (count - 1) == 0:
            self._reach_m = float(np.sqrt(self.squared.max()))
