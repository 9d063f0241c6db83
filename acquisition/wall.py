"""The relay wall and the grid of points sampled on it."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.lattice import lattice_of

Floats = npt.NDArray[np.float64]

ORIENTATION = (
    "row 0 is the top and column 0 the left for who looks at the wall from the scanner; x_m counts to the right, y_m up"
)
BESIDE = 0.6
"""Of their extent: points whose middle is farther from 0 are beside it; half a wall's is half of its extent away."""


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

    def x_m(self) -> Floats:
        """Column centres, left to right, shape (W,)."""
        return ((np.arange(self.cols) + 0.5) / self.cols - 0.5) * self.width_m

    def y_m(self) -> Floats:
        """Row centres, top to bottom, shape (H,)."""
        return (0.5 - (np.arange(self.rows) + 0.5) / self.rows) * self.height_m

    @property
    def longer_m(self) -> float:
        """The longer of its sides: a line of points up the wall sees as sharply as one across it."""
        return max(self.width_m, self.height_m)


def grid_around(x_m: Floats, y_m: Floats, size_m: tuple[float, float] | None = None) -> WallGrid:
    """A grid for N points at free positions (N,), fine enough that hardly two share a pixel: their own where they lie
    on one (`lattice_of`).

    `size_m`: width and height of the wall; without, the smallest wall around its centre that holds all points. Square
    pixels, 32 to 256 along the longer side, about two per mean spacing of the points.
    """
    if (lattice := lattice_of(x_m, y_m, size_m)) is not None:
        return WallGrid(*lattice)
    count = len(x_m)
    if size_m is None:
        reach_x, reach_y = float(np.abs(x_m).max()), float(np.abs(y_m).max())
        largest = max(reach_x, reach_y, 1e-3)
        edge = 1 + 1 / math.sqrt(count)  # half a spacing beyond the outermost points
        size_m = 2 * max(reach_x, largest / 8) * edge, 2 * max(reach_y, largest / 8) * edge
    width_m, height_m = size_m
    longer = max(width_m, height_m)
    pixels = int(np.clip(round(2 * math.sqrt(count * longer / min(width_m, height_m))), 32, 256))
    return WallGrid(
        width_m, height_m, max(1, round(pixels * height_m / longer)), max(1, round(pixels * width_m / longer))
    )


def about_their_middle(x_m: Floats, y_m: Floats) -> tuple[Floats, Floats, str]:
    """Places (N,) of points of a wall of unknown size, about their own middle where all of them lie beside 0, and what
    is said of it; as they are and "" elsewhere. A wall around 0 that holds them would be far larger than what was
    scanned: by one axis where they are far off, by both where 0 is a corner of theirs, as many files have it."""
    places = x_m, y_m
    middles = [(float(each.min()) + float(each.max())) / 2 for each in places]
    near = all(abs(middle) <= BESIDE * float(np.ptp(each)) for middle, each in zip(middles, places, strict=True))
    around_0 = any(each.min() < 0 < each.max() for each in places)
    if near and around_0:
        return x_m, y_m, ""
    said = (
        f"its points are around ({middles[0]:.4g}, {middles[1]:.4g}) m, which is taken for the wall's middle; from "
        "here on places count from there (if 0 is the wall's middle: --wall-size-m, wall in Python)"
    )
    return x_m - middles[0], y_m - middles[1], said
