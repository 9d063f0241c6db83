"""Circle: a single confocal scan along a circle (C2NLOS, Isogawa et al., ECCV 2020)."""

from typing import Literal

import numpy as np
from pydantic import Field

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.positions import Positions, free
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings


class Circle(Settings):
    """`points` at equal distances along a circle around the wall's centre."""

    kind: Literal["circle"] = "circle"
    count: int = Field(ge=1, le=1_000_000, alias="points")
    """Points along the circle."""
    radius_m: float = Field(gt=0)
    """Its radius."""
    x_m: float = 0.0
    """Its centre, to the right of the wall's."""
    y_m: float = 0.0
    """Its centre, above the wall's."""

    def points(self, wall: WallGrid) -> Positions:
        """Anticlockwise from the right. Raises `PlanRefused` where the circle leaves the wall."""
        if abs(self.x_m) + self.radius_m > wall.width_m / 2 or abs(self.y_m) + self.radius_m > wall.height_m / 2:
            raise PlanRefused(f"a circle of {self.radius_m:g} m around ({self.x_m:g}, {self.y_m:g}) m leaves the wall")
        angle = 2 * np.pi * np.arange(self.count) / self.count
        return free(self.x_m + self.radius_m * np.cos(angle), self.y_m + self.radius_m * np.sin(angle))
