"""Uniform sub-grid: R x C pixels spread evenly over a dense grid, whose indices they keep."""

from typing import Literal

import numpy as np
from pydantic import Field

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.positions import Positions, pixels
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings


class Subgrid(Settings):
    """`rows` x `cols` pixels spread evenly over the wall's grid, in serpentine order."""

    kind: Literal["subgrid"] = "subgrid"
    rows: int = Field(ge=1, le=4096)
    """Measured rows."""
    cols: int = Field(ge=1, le=4096)
    """Measured columns."""

    def points(self, wall: WallGrid) -> Positions:
        """Pixels floor((i + 0.5) H / R). Raises `PlanRefused` where the wall's grid has fewer."""
        if self.rows > wall.rows or self.cols > wall.cols:
            raise PlanRefused(
                f"a sub-grid of {self.rows} x {self.cols} is not part of {wall.rows} x {wall.cols} pixels"
            )
        row, along = np.divmod(np.arange(self.rows * self.cols), self.cols)
        col = np.where(row % 2 == 0, along, self.cols - 1 - along)
        return pixels(wall, (2 * row + 1) * wall.rows // (2 * self.rows), (2 * col + 1) * wall.cols // (2 * self.cols))
