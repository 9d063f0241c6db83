"""From samples at any wall positions, or from part of a grid, to the regular grid that methods work on.

Histograms are interpolated linearly between the nearest samples: along rows and columns where the samples form a grid
of their own (as the paper does with its 32 x 32 and 64 x 64 scans), over Delaunay triangles where they do not. Outside
of all samples the nearest one is taken, and the confidence map says how far away that was.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
import torch
from scipy.spatial import Delaunay, KDTree, QhullError

from acquisition.transient import TimeAxis, Transient
from acquisition.wall import WallGrid
from recon.errors import InvalidData
from recon.transport.linear import linear

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Gridded:
    """A transient on the wall's grid, and how far each of its points can be trusted, (H, W) in 0 to 1."""

    transient: Transient
    confidence: Floats


def grid_samples(
    x_m: Floats, y_m: Floats, counts: npt.NDArray[np.float32], exposure_s: Floats, wall: WallGrid, time: TimeAxis
) -> Gridded:
    """Samples at (x_m, y_m) (N,) with counts (N, T) and exposure_s (N,), unmeasured ones at 0, on the grid of `wall`.

    Samples in one wall pixel are added up at their mean position, weighted by exposure. Raises `InvalidData` where no
    sample was measured or one is not finite.
    """
    if not (np.isfinite(x_m).all() and np.isfinite(y_m).all() and np.isfinite(counts).all()):
        raise InvalidData("a sample's position or one of its counts is not finite; leave that sample out.")
    measured = exposure_s > 0
    if not measured.any():
        raise InvalidData("no sample was measured: every exposure is 0.")
    col, row = _pixels(x_m[measured], y_m[measured], wall)
    pixel = np.rint(row).astype(np.int64) * (4 * wall.cols) + np.rint(col).astype(np.int64)
    _, which = np.unique(pixel, return_inverse=True)
    merge = scipy.sparse.csr_array((np.ones(len(which)), (which, np.arange(len(which)))))
    total_s = _times(merge, exposure_s[measured])
    col = _times(merge, col * exposure_s[measured]) / total_s
    row = _times(merge, row * exposure_s[measured]) / total_s
    rates = _times(merge, counts[measured].astype(np.float64)) / total_s[:, None]
    spread = interpolation(row, col, wall.rows, wall.cols)
    on_grid_s = _times(spread, total_s).reshape(wall.rows, wall.cols)
    on_grid = _times(spread, rates) * on_grid_s.reshape(-1, 1)
    cube = np.ascontiguousarray(on_grid.T.reshape(time.bins, wall.rows, wall.cols), dtype=np.float32)
    nearness = confidence(row, col, wall.rows, wall.cols)
    enough = np.minimum(1.0, on_grid_s / np.median(total_s))
    return Gridded(Transient(cube, on_grid_s, wall, time), nearness * enough)


def fill_unmeasured(rates: torch.Tensor, measured: torch.Tensor) -> torch.Tensor:
    """(B, C, T, H, W) with the points that are not `measured` (B, H, W) interpolated from those that are."""
    if bool(measured.all()):
        return rates
    return torch.stack([_filled(sample, where) for sample, where in zip(rates, measured, strict=True)])


def _filled(sample: torch.Tensor, measured: torch.Tensor) -> torch.Tensor:
    if bool(measured.all()):
        return sample
    if not bool(measured.any()):
        raise InvalidData("no point of the wall was measured: every exposure is 0.")
    rows, cols = measured.shape
    mask = measured.cpu().numpy()
    matrix = _fill_matrix(mask.tobytes(), rows, cols)

    def times(held: scipy.sparse.csr_array, x: torch.Tensor) -> torch.Tensor:
        flat = x.detach().reshape(-1, rows * cols).T.cpu().numpy()
        done = np.ascontiguousarray((held.astype(flat.dtype) @ flat).T)
        return torch.from_numpy(done).to(x.device).reshape(x.shape)

    transposed = scipy.sparse.csr_array(matrix.T)
    return linear(sample, lambda x: times(matrix, x), lambda x: times(transposed, x))


@lru_cache(maxsize=16)
def _fill_matrix(mask: bytes, rows: int, cols: int) -> scipy.sparse.csr_array:
    """(H * W, H * W): every grid point from the measured ones."""
    chosen = np.flatnonzero(np.frombuffer(mask, dtype=np.bool_))
    row, col = (part.astype(np.float64) for part in np.divmod(chosen, cols))
    spread = interpolation(row, col, rows, cols).tocoo()
    return scipy.sparse.csr_array((spread.data, (spread.row, chosen[spread.col])), shape=(rows * cols, rows * cols))


def interpolation(row: Floats, col: Floats, rows: int, cols: int) -> scipy.sparse.csr_array:
    """The matrix (H * W, N) of linear interpolation from samples at fractional (row, col) to the grid."""
    grid_rows, grid_cols = np.unique(row), np.unique(col)
    if len(row) == len(grid_rows) * len(grid_cols) and len(set(zip(row, col, strict=True))) == len(row):
        order = np.lexsort((col, row))  # the samples as a grid of their own, row by row
        both = scipy.sparse.kron(_between(grid_rows, rows), _between(grid_cols, cols)).tocoo()
        return scipy.sparse.csr_array((both.data, (both.row, order[both.col])), shape=(rows * cols, len(row)))
    return _over_triangles(np.stack([row, col], axis=1).astype(np.float64), rows, cols)


def confidence(row: Floats, col: Floats, rows: int, cols: int) -> Floats:
    """exp(-d^2 / 2) of the distance d in pixels to the nearest sample, (H, W)."""
    distance, _ = KDTree(np.stack([row, col], axis=1)).query(_points(rows, cols))
    return np.exp(-0.5 * np.asarray(distance) ** 2).reshape(rows, cols)


def _between(at: Floats, count: int) -> scipy.sparse.coo_array:
    """Linear interpolation in one dimension from positions `at` to 0 .. count - 1, constant beyond the ends."""
    target = np.clip(np.arange(count), at[0], at[-1])
    if len(at) == 1:
        return scipy.sparse.coo_array(np.ones((count, 1)))
    above = np.asarray(np.clip(np.searchsorted(at, target), 1, len(at) - 1))
    weight = (target - at[above - 1]) / (at[above] - at[above - 1])
    index = np.arange(count)
    return scipy.sparse.coo_array(
        (np.concatenate([1 - weight, weight]), (np.tile(index, 2), np.concatenate([above - 1, above]))),
        shape=(count, len(at)),
    )


def _over_triangles(samples: Floats, rows: int, cols: int) -> scipy.sparse.csr_array:
    points = _points(rows, cols)
    shape = (rows * cols, len(samples))
    nearest = np.asarray(KDTree(samples).query(points)[1])
    try:
        mesh = Delaunay(samples)
    except (QhullError, ValueError):  # too few, or all on a line: there are no triangles
        return scipy.sparse.csr_array((np.ones(len(points)), (np.arange(len(points)), nearest)), shape=shape)
    triangle = mesh.find_simplex(points, tol=1e-9)
    inside = np.flatnonzero(triangle >= 0)
    to_first_two = mesh.transform[triangle[inside]]
    weights = np.einsum("nij,nj->ni", to_first_two[:, :2], points[inside] - to_first_two[:, 2])
    weights = np.concatenate([weights, 1 - weights.sum(1, keepdims=True)], axis=1)
    outside = np.flatnonzero(triangle < 0)
    index = np.concatenate([np.repeat(inside, 3), outside])
    column = np.concatenate([mesh.simplices[triangle[inside]].ravel(), nearest[outside]])
    return scipy.sparse.csr_array((np.concatenate([weights.ravel(), np.ones(len(outside))]), (index, column)), shape)


def _times(matrix: scipy.sparse.csr_array, x: npt.NDArray[Any]) -> Floats:
    return np.asarray(matrix @ x, dtype=np.float64)


def _points(rows: int, cols: int) -> Floats:
    return np.stack(np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"), axis=-1).reshape(-1, 2).astype(float)


def _pixels(x_m: Floats, y_m: Floats, wall: WallGrid) -> tuple[Floats, Floats]:
    """Fractional (col, row) of wall positions."""
    col = (x_m / wall.width_m + 0.5) * wall.cols - 0.5
    row = (0.5 - y_m / wall.height_m) * wall.rows - 0.5
    return col, row
