"""Marks on the pixels of a picture that are seen without colours: strokes over some, a line around others."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path

Sides = tuple[float, float, float, float]
"""Left, right, bottom and top of a picture, as `imshow` takes its extent."""
_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
_AROUND = np.array([Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY], dtype=np.uint8)


def hatch(axes: Axes, where: npt.NDArray[np.bool_], sides: Sides, ink: str) -> None:
    """Strokes of this colour over the pixels `where` (H, W)."""
    row, col = np.nonzero(where)
    if not len(row):
        return
    corners = np.stack([col, row], axis=1)[:, None] + _CORNERS  # (N, 5, 2)
    path = Path(_placed(corners.reshape(-1, 2), where.shape, sides), np.tile(_AROUND, len(row)))
    axes.add_patch(PathPatch(path, facecolor="none", edgecolor=ink, hatch="///", linewidth=0))


def outline(axes: Axes, where: npt.NDArray[np.bool_], sides: Sides) -> None:
    """A thin dark line between the pixels `where` (H, W) and all others."""
    inside = np.pad(where, 1)
    row, col = np.nonzero(inside[1:, 1:-1] != inside[:-1, 1:-1])
    level = np.stack([col, row, col + 1, row], axis=1)
    row, col = np.nonzero(inside[1:-1, 1:] != inside[1:-1, :-1])
    upright = np.stack([col, row, col, row + 1], axis=1)
    ends = np.concatenate([level, upright]).reshape(-1, 2)
    codes = np.tile(_AROUND[:2], len(ends) // 2)
    path = Path(_placed(ends, where.shape, sides), codes)
    axes.add_patch(PathPatch(path, facecolor="none", edgecolor="black", linewidth=0.6, alpha=0.7))


def _placed(corners: npt.NDArray[np.integer], shape: tuple[int, ...], sides: Sides) -> npt.NDArray[np.float64]:
    """Columns and rows, counted at the edges of pixels, in the picture's own coordinates."""
    left, right, bottom, top = sides
    rows, cols = shape
    return np.stack([left + corners[:, 0] * (right - left) / cols, top + corners[:, 1] * (bottom - top) / rows], axis=1)
