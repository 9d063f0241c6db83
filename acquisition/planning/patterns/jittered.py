"""Jittered: the wall is cut into R x C cells, and one pixel is drawn in each."""

from typing import Literal

import numpy as np
from pydantic import Field

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.positions import Positions, pixels
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings


class Jittered(Settings):
    """One random pixel in each of `rows` x `cols` cells (stratified sampling)."""

    kind: Literal["jittered"] = "jittered"
    rows: int = Field(ge=1, le=4096)
    """Cells from top to bottom."""
    cols: int = Field(ge=1, le=4096)
    """Cells from left to right."""
    seed: int = Field(default=0, ge=0)
    """Of the random numbers: the same seed gives the same points."""

    def points(self, wall: WallGrid) -> Positions:
        """Drawn cell by cell. Raises `PlanRefused` where a cell would hold no pixel."""
        if self.rows > wall.rows or self.cols > wall.cols:
            raise PlanRefused(f"{self.rows} x {self.cols} cells are too many for {wall.rows} x {wall.cols} pixels")
        draw = np.random.default_rng(self.seed)
        row, col = np.divmod(np.arange(self.rows * self.cols), self.cols)
        top, bottom = row * wall.rows // self.rows, (row + 1) * wall.rows // self.rows
        left, right = col * wall.cols // self.cols, (col + 1) * wall.cols // self.cols
        return pixels(wall, draw.integers(top, bottom), draw.integers(left, right))
