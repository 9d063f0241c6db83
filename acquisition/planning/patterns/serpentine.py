"""Serpentine: row by row from the top, every other row backwards, so that no step is longer than a pixel."""

from typing import Literal

import numpy as np

from nlos.acquisition.planning.positions import Positions, pixels
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings


class Serpentine(Settings):
    """Every pixel, row by row, every other row from right to left."""

    kind: Literal["serpentine"] = "serpentine"

    def points(self, wall: WallGrid) -> Positions:
        """All rows x cols pixels of the wall."""
        row, along = np.divmod(np.arange(wall.rows * wall.cols), wall.cols)
        return pixels(wall, row, np.where(row % 2 == 0, along, wall.cols - 1 - along))
