"""Parts of a wall grid: what a sparse scan would have measured of a full one."""

import re

import numpy as np
import numpy.typing as npt

from nlos.recon.errors import InvalidSettings

SEED = 7


def measured_points(subset: str, rows: int, cols: int) -> npt.NDArray[np.bool_]:
    """The points of a grid (H, W) that `subset` keeps.

    "" keeps all; "RxC" the rows floor((i + 0.5) H / R) and the columns likewise; "blue:N" N points as far from one
    another as they go, always the same ones. Raises `InvalidSettings` for anything else.
    """
    kept = np.zeros((rows, cols), dtype=np.bool_)
    if subset == "":
        return ~kept
    if found := re.fullmatch(r"(\d+)x(\d+)", subset):
        r, c = int(found[1]), int(found[2])
        if not (1 <= r <= rows and 1 <= c <= cols):
            raise InvalidSettings(f"a grid of {rows} x {cols} has no {r} x {c} points; ask for 1x1 to {rows}x{cols}")
        kept[np.ix_(_middles(r, rows), _middles(c, cols))] = True
        return kept
    if found := re.fullmatch(r"blue:(\d+)", subset):
        count = int(found[1])
        if not 1 <= count <= rows * cols:
            raise InvalidSettings(f"a grid of {rows} x {cols} has no {count} points; ask for 1 to {rows * cols}")
        kept.reshape(-1)[blue_noise(rows, cols, count, SEED)] = True
        return kept
    raise InvalidSettings(f"a subset is RxC (16x16) or blue:N (blue:256), not '{subset}'")


def _middles(parts: int, count: int) -> npt.NDArray[np.int64]:
    """floor((i + 0.5) count / parts) for i = 0 .. parts - 1."""
    return (2 * np.arange(parts) + 1) * count // (2 * parts)


def blue_noise(rows: int, cols: int, count: int, seed: int) -> npt.NDArray[np.int64]:
    """Flat indices of `count` grid points, (N,): each as far as possible from all before it, ties broken by `seed`."""
    row, col = np.divmod(np.arange(rows * cols), cols)
    jitter = np.random.default_rng(seed).uniform(0, 0.5, rows * cols)  # of a squared pixel: no lattice out of ties
    chosen = np.empty(count, dtype=np.int64)
    chosen[0] = int(np.argmax(jitter))
    nearest = np.full(rows * cols, np.inf)
    for k in range(1, count):
        last = chosen[k - 1]
        nearest = np.minimum(nearest, (row - row[last]) ** 2 + (col - col[last]) ** 2)
        nearest[last] = -np.inf
        chosen[k] = int(np.argmax(nearest + jitter))
    return chosen
