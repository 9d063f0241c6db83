"""Fermat spiral: the sunflower's, r = c sqrt(n), which covers a disc or a rectangle evenly without a grid."""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.positions import Positions, free
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


class FermatSpiral(Settings):
    """Sunflower points `dr_m` / `factor` apart, over the whole rectangle of the wall.

    r = dr sqrt(n) / factor, theta = n times the golden angle; `dr`, `factor` and `tilt` as in bluesky's
    `spiral_fermat`.
    """

    kind: Literal["fermat_spiral"] = "fermat_spiral"
    dr_m: float = Field(gt=0)
    """Scale of the spiral, r = dr sqrt(n) / factor."""
    factor: float = Field(default=1.0, gt=0)
    """Divides the spacing: larger is denser."""
    tilt_deg: float = 0.0
    """Turns the spiral about the wall's centre."""

    def points(self, wall: WallGrid) -> Positions:
        """From the centre outwards, as the flower grows. Raises `PlanRefused` for more than a million points."""
        reach_m = math.hypot(wall.width_m, wall.height_m) / 2
        count = int((reach_m * self.factor / self.dr_m) ** 2) + 1
        if count > 1_000_000:
            raise PlanRefused(f"dr of {self.dr_m:g} m and factor {self.factor:g} make more than a million points")
        n = np.arange(count)
        radius_m = self.dr_m * np.sqrt(n) / self.factor
        angle = n * GOLDEN_ANGLE + math.radians(self.tilt_deg)
        x_m, y_m = radius_m * np.cos(angle), radius_m * np.sin(angle)
        inside = (np.abs(x_m) <= wall.width_m / 2) & (np.abs(y_m) <= wall.height_m / 2)
        return free(x_m[inside], y_m[inside])
