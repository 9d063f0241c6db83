"""Random: N different pixels of the grid, all equally likely."""

from typing import Literal

import numpy as np
from pydantic import Field

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.positions import Positions, pixels
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings


class RandomPixels(Settings):
    """`points` different pixels, each as likely as any other."""

    kind: Literal["random"] = "random"
    count: int = Field(ge=1, le=4096 * 4096, alias="points")
    """How many pixels are measured."""
    seed: int = Field(default=0, ge=0)
    """Of the random numbers: the same seed gives the same points."""

    def points(self, wall: WallGrid) -> Positions:
        """Drawn without replacement. Raises `PlanRefused` where the grid has fewer pixels."""
        if self.count > wall.rows * wall.cols:
            raise PlanRefused(f"{self.count} different pixels are more than {wall.rows} x {wall.cols}")
        chosen = np.random.default_rng(self.seed).choice(wall.rows * wall.cols, self.count, replace=False)
        return pixels(wall, *np.divmod(chosen, wall.cols))
