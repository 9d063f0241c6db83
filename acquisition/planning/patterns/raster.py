"""Raster: row by row from the top, every row from left to right."""

from typing import Literal

import numpy as np

from nlos.acquisition.planning.positions import Positions, pixels
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings


class Raster(Settings):
    """Every pixel, row by row, each row from left to right."""

    kind: Literal["raster"] = "raster"

    def points(self, wall: WallGrid) -> Positions:
        """All rows x cols pixels of the wall."""
        row, col = np.divmod(np.arange(wall.rows * wall.cols), wall.cols)
        return pixels(wall, row, col)
