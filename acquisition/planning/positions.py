"""Where a pattern goes on the wall, in order: arrays of places, on the grid's pixels or free of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.wall import WallGrid

OFF_GRID = -1
"""The `row` and `col` of a place that is not a pixel of the wall's grid."""


@dataclass(frozen=True, eq=False)
class Positions:
    """Places in the order of visit. `row`, `col` are dense indices into the wall's grid, or `OFF_GRID`."""

    row: npt.NDArray[np.int32]  # (N,)
    col: npt.NDArray[np.int32]  # (N,)
    x_m: npt.NDArray[np.float64]  # (N,)
    y_m: npt.NDArray[np.float64]  # (N,)

    def __post_init__(self) -> None:
        lengths = {len(self.row), len(self.col), len(self.x_m), len(self.y_m)}
        if len(lengths) != 1:
            raise ValueError(f"row, col, x_m and y_m have different lengths: {sorted(lengths)}")

    def __len__(self) -> int:
        return len(self.x_m)

    @property
    def on_grid(self) -> bool:
        """Whether every place is a pixel of the wall's grid."""
        return bool((self.row >= 0).all() and (self.col >= 0).all())

    def take(self, index: npt.NDArray[np.intp]) -> "Positions":
        """The places at `index`, in that order."""
        return Positions(self.row[index], self.col[index], self.x_m[index], self.y_m[index])


def pixels(wall: WallGrid, row: npt.ArrayLike, col: npt.ArrayLike) -> Positions:
    """The centres of pixels (`row`, `col`) of the grid. Raises `ValueError` for a pixel that the grid has not."""
    rows = np.asarray(row, dtype=np.int32).ravel()
    cols = np.asarray(col, dtype=np.int32).ravel()
    if len(rows) and not (rows.min() >= 0 and rows.max() < wall.rows and cols.min() >= 0 and cols.max() < wall.cols):
        raise ValueError(f"a pixel lies outside the grid of {wall.rows} x {wall.cols}")
    return Positions(rows, cols, wall.x_m()[cols], wall.y_m()[rows])


def free(x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> Positions:
    """Places that belong to no pixel."""
    x = np.asarray(x_m, dtype=np.float64).ravel()
    y = np.asarray(y_m, dtype=np.float64).ravel()
    nowhere = np.full(len(x), OFF_GRID, dtype=np.int32)
    return Positions(nowhere, nowhere, x, y)


def joined(parts: Sequence[Positions]) -> Positions:
    """One list of places after the other."""
    return Positions(
        np.concatenate([part.row for part in parts]),
        np.concatenate([part.col for part in parts]),
        np.concatenate([part.x_m for part in parts]),
        np.concatenate([part.y_m for part in parts]),
    )
