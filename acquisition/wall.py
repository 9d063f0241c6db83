"""The relay wall and the grid of points sampled on it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class WallGrid:
    """A `rows` x `cols` grid of pixels over a wall of `width_m` x `height_m`; points sit at pixel centres.

    Origin at the wall's centre, x right, y up; row 0 is the top, column 0 the left.
    """

    width_m: float
    height_m: float
    rows: int
    cols: int

    def __post_init__(self) -> None:
        if not (self.width_m > 0 and self.height_m > 0):
            raise ValueError(f"wall is {self.width_m:g} m x {self.height_m:g} m; both sides must be above 0")
        if not (self.rows > 0 and self.cols > 0):
            raise ValueError(f"wall grid is {self.rows} x {self.cols}; both counts must be above 0")

    def x_m(self) -> npt.NDArray[np.float64]:
        """Column centres, left to right, shape (W,)."""
        return ((np.arange(self.cols) + 0.5) / self.cols - 0.5) * self.width_m

    def y_m(self) -> npt.NDArray[np.float64]:
        """Row centres, top to bottom, shape (H,)."""
        return (0.5 - (np.arange(self.rows) + 0.5) / self.rows) * self.height_m
