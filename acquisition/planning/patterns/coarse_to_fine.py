"""Coarse to fine: every pixel, in an order in which every beginning covers the wall evenly."""

from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from nlos.acquisition.planning.ordering import strips
from nlos.acquisition.planning.positions import Positions, pixels
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings


class CoarseToFine(Settings):
    """Every pixel, such that every beginning covers the wall evenly; a scan may end at any time.

    Jumps across the wall cost settling time: `batch` points at a time are put on a short path, and the wall is then
    covered evenly after every batch.
    """

    kind: Literal["coarse_to_fine"] = "coarse_to_fine"
    batch: int = Field(default=1, ge=1)
    """Points that are put on a short path together."""

    def points(self, wall: WallGrid) -> Positions:
        """By rank in the dispersed-dot dither matrix (Bayer 1973) that the grid is a corner of."""
        row, col = np.divmod(np.arange(wall.rows * wall.cols), wall.cols)
        everywhere = pixels(wall, row, col)
        order = np.argsort(_dither_rank(row, col, max(wall.rows, wall.cols)), kind="stable")
        if self.batch > 1:
            parts = [order[first : first + self.batch] for first in range(0, len(order), self.batch)]
            order = np.concatenate([part[strips(everywhere.x_m[part], everywhere.y_m[part])] for part in parts])
        return everywhere.take(order)


def _dither_rank(row: npt.NDArray[np.intp], col: npt.NDArray[np.intp], size: int) -> npt.NDArray[np.intp]:
    """Bits of (row xor col) and row, interleaved and read backwards: the finest bit weighs most."""
    rank = np.zeros_like(row)
    for bit in range(max(size - 1, 1).bit_length()):
        rank = 4 * rank + 2 * (((row ^ col) >> bit) & 1) + ((row >> bit) & 1)
    return rank
