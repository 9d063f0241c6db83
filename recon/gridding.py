"""From samples at any wall positions, or from part of a grid, to the regular grid that methods work on.

A sample belongs to the pixel it lies in, with its counts and its exposure; pixels without one are marked as not
measured and interpolated when their noise is known. Along rows and columns where the measured pixels form a grid of
their own (as the paper does with its 32 x 32 and 64 x 64 scans), over Delaunay triangles where they do not.
"""

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import InvalidData

if TYPE_CHECKING:
    import torch

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

_BINS = 64
HOLE_SPACINGS, HOLE_OF_WALL = 8.0, 0.25
"""A triangle with a side longer than both, in spacings of the samples and in parts of the wall, is a hole."""


def grid_samples(
    x_m: Floats, y_m: Floats, counts: npt.NDArray[Any], exposure_s: Floats, wall: WallGrid, time: TimeAxis
) -> Transient:
    """Samples at (x_m, y_m) (N,) with counts (N, T) and exposure_s (N,) on the grid of `wall`, those of one pixel added
    up; exposure 0 where there is none.

    Raises `InvalidData` where no sample was measured, one is not finite, or one lies beside the wall.
    """
    if not (np.isfinite(x_m).all() and np.isfinite(y_m).all() and np.isfinite(counts).all()):
        raise InvalidData("a sample's position or one of its counts is not finite; leave that sample out.")
    measured = exposure_s > 0
    if not measured.any():
        raise InvalidData("no sample was measured: every exposure is 0.")
    col = np.rint((x_m[measured] / wall.width_m + 0.5) * wall.cols - 0.5).astype(np.int64)
    row = np.rint((0.5 - y_m[measured] / wall.height_m) * wall.rows - 0.5).astype(np.int64)
    # A position on the very edge of the wall may round to the pixel beside it.
    beside = (row < -1) | (row > wall.rows) | (col < -1) | (col > wall.cols)
    if beside.any():
        first = int(np.flatnonzero(measured)[np.argmax(beside)])
        wide, high = np.ptp(x_m[measured]), np.ptp(y_m[measured])
        hint = "Give the size of the wall that was scanned."
        if wide <= wall.width_m and high <= wall.height_m:
            hint = (
                "They would fit on it: places count from the wall's middle. Subtract it, or leave the wall's size out."
            )
        raise InvalidData(
            f"{int(beside.sum())} of {len(row)} samples lie beside the wall of {wall.width_m:g} x {wall.height_m:g} m, "
            f"the first at ({x_m[first]:+.3f} m, {y_m[first]:+.3f} m). {hint}"
        )
    pixel = np.clip(row, 0, wall.rows - 1) * wall.cols + np.clip(col, 0, wall.cols - 1)
    points = wall.rows * wall.cols
    merge = scipy.sparse.csr_array(
        (np.ones(len(pixel), np.float32), (pixel, np.arange(len(pixel)))), (points, len(pixel))
    )
    cube, taken = np.empty((time.bins, points), dtype=np.float32), np.flatnonzero(measured)
    for first in range(0, time.bins, _BINS):  # a copy of all counts would take as much memory once more
        some = slice(first, first + _BINS)
        cube[some] = (merge @ counts[taken, some].astype(np.float32)).T
    on_grid_s = np.bincount(pixel, weights=exposure_s[measured], minlength=points)
    shape = wall.rows, wall.cols
    return Transient(cube.reshape(-1, *shape), on_grid_s.astype(np.float64).reshape(shape), wall, time)


def confidence(exposure_s: Floats) -> npt.NDArray[np.float32]:
    """How far each pixel of a wall with exposures (H, W) can be trusted, 0 to 1.

    exp(-d^2 / 2) of the distance d in pixels to the nearest measured one, times that one's exposure over the median,
    at most 1; 0 where nothing was measured.
    """
    measured = exposure_s > 0
    if not measured.any():
        return np.zeros(exposure_s.shape, np.float32)
    distance, (row, col) = scipy.ndimage.distance_transform_edt(~measured, return_indices=True)
    enough = np.minimum(1.0, exposure_s[row, col] / np.median(exposure_s[measured]))
    return np.asarray(np.exp(-0.5 * distance**2) * enough, dtype=np.float32)


def fill_unmeasured(rates: "torch.Tensor", measured: "torch.Tensor") -> "torch.Tensor":
    """(B, C, T, H, W) with the points that are not `measured` (B, H, W) interpolated from those that are."""
    if bool(measured.all()):
        return rates
    import torch

    return torch.stack([_filled(sample, where) for sample, where in zip(rates, measured, strict=True)])


def filled(x: npt.NDArray[np.float32], measured: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
    """`fill_unmeasured` for an array (..., H, W) with one map of `measured` points (H, W)."""
    return x if measured.all() else _times(fill_matrix(measured), x)


def fill_matrix(measured: npt.NDArray[np.bool_]) -> "scipy.sparse.csr_array":
    """(H * W, H * W): every grid point from the `measured` ones (H, W). Raises `InvalidData` where there is none."""
    if not measured.any():
        raise InvalidData("no point of the wall was measured: every exposure is 0.")
    return _fill_matrix(measured.tobytes(), *measured.shape)


def _times(matrix: "scipy.sparse.csr_array", x: npt.NDArray[Any]) -> npt.NDArray[Any]:
    flat = x.reshape(-1, matrix.shape[0]).T
    return np.ascontiguousarray((matrix.astype(flat.dtype) @ flat).T).reshape(x.shape)


def _filled(sample: "torch.Tensor", measured: "torch.Tensor") -> "torch.Tensor":
    if bool(measured.all()):
        return sample
    import torch

    from nlos.recon.transport.linear import linear

    matrix = fill_matrix(measured.cpu().numpy())
    transposed = scipy.sparse.csr_array(matrix.T)

    def times(held: "scipy.sparse.csr_array", x: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(_times(held, x.detach().cpu().numpy())).to(x.device)

    return linear(sample, lambda x: times(matrix, x), lambda x: times(transposed, x))


@lru_cache(maxsize=16)
def _fill_matrix(mask: bytes, rows: int, cols: int) -> "scipy.sparse.csr_array":
    """(H * W, H * W): every grid point from the measured ones."""
    chosen = np.flatnonzero(np.frombuffer(mask, dtype=np.bool_))
    row, col = np.divmod(chosen, cols)
    spread = interpolation(row, col, rows, cols).tocoo()
    return scipy.sparse.csr_array((spread.data, (spread.row, chosen[spread.col])), shape=(rows * cols, rows * cols))


def interpolation(row: Ints, col: Ints, rows: int, cols: int) -> "scipy.sparse.csr_array":
    """The matrix (H * W, N) of linear interpolation from the N different pixels (row, col) to all of the grid."""
    grid_rows, grid_cols = np.unique(row), np.unique(col)
    if len(row) == len(grid_rows) * len(grid_cols):
        order = np.lexsort((col, row))  # the samples as a grid of their own, row by row
        both = scipy.sparse.kron(_between(grid_rows, rows), _between(grid_cols, cols)).tocoo()
        return scipy.sparse.csr_array((both.data, (both.row, order[both.col])), shape=(rows * cols, len(row)))
    return _over_triangles(row, col, rows, cols)


def _between(at: Ints, count: int) -> "scipy.sparse.coo_array":
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


def _over_triangles(row: Ints, col: Ints, rows: int, cols: int) -> "scipy.sparse.csr_array":
    """Linear interpolation inside the triangles between samples, 0 in holes; beyond all of them the nearest sample.

    Samples around more hole than area lie along a curve, not on a surface: nothing is interpolated between those.
    """
    samples = np.stack([row, col], axis=1).astype(np.float64)
    points = np.stack(np.divmod(np.arange(rows * cols), cols), axis=1).astype(np.float64)
    shape = (rows * cols, len(samples))
    tree = scipy.spatial.KDTree(samples)
    nearest = np.asarray(tree.query(points)[1])
    try:
        mesh = scipy.spatial.Delaunay(samples)
    except (scipy.spatial.QhullError, ValueError):  # too few, or all on a line: there are no triangles
        return scipy.sparse.csr_array((np.ones(len(points)), (np.arange(len(points)), nearest)), shape=shape)
    spacing = float(np.median(np.asarray(tree.query(samples, k=2)[0])[:, 1]))
    corners = samples[mesh.simplices]  # (M, 3, 2)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    hole = longest > max(HOLE_SPACINGS * spacing, HOLE_OF_WALL * max(rows, cols))
    area = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    if area[hole].sum() > area[~hole].sum():
        return scipy.sparse.csr_array((np.ones(len(row)), (row * cols + col, np.arange(len(row)))), shape=shape)
    triangle = mesh.find_simplex(points, tol=1e-9)
    inside = np.flatnonzero((triangle >= 0) & ~hole[triangle])
    to_first_two = mesh.transform[triangle[inside]]
    weights = np.einsum("nij,nj->ni", to_first_two[:, :2], points[inside] - to_first_two[:, 2])
    weights = np.concatenate([weights, 1 - weights.sum(1, keepdims=True)], axis=1)
    outside = np.flatnonzero(triangle < 0)
    index = np.concatenate([np.repeat(inside, 3), outside])
    column = np.concatenate([mesh.simplices[triangle[inside]].ravel(), nearest[outside]])
    return scipy.sparse.csr_array((np.concatenate([weights.ravel(), np.ones(len(outside))]), (index, column)), shape)
