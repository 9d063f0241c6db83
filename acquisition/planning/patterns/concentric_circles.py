"""Concentric circles around the wall's centre, with the same distance between points on all of them."""

from typing import Literal

import numpy as np
from pydantic import Field

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.positions import Positions, free
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings


class ConcentricCircles(Settings):
    """`points` over `circles` circles; the outermost touches the wall's nearer edges."""

    kind: Literal["concentric_circles"] = "concentric_circles"
    circles: int = Field(ge=1, le=4096)
    """Number of circles."""
    count: int = Field(ge=1, le=1_000_000, alias="points")
    """Points over all circles."""

    def points(self, wall: WallGrid) -> Positions:
        """From the innermost circle outwards, each turn in the other direction. Raises `PlanRefused` for fewer points
        than circles."""
        if self.count < self.circles:
            raise PlanRefused(f"{self.count} points are too few for {self.circles} circles")
        radius_m = min(wall.width_m, wall.height_m) / 2 * np.arange(1, self.circles + 1) / self.circles
        until = np.round(np.cumsum(radius_m) / radius_m.sum() * (self.count - self.circles)).astype(int)
        counts = 1 + np.diff(until, prepend=0)
        turns = [(-1) ** k * 2 * np.pi * np.arange(count) / count for k, count in enumerate(counts.tolist())]
        radii = np.repeat(radius_m, counts)
        angle = np.concatenate(turns)
        return free(radii * np.cos(angle), radii * np.sin(angle))
