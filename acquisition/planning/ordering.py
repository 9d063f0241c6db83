"""The order in which irregular points are visited: short steps settle fast.

A mirror settles after the longer of its two axes' steps, so distances are Chebyshev distances.
"""

import math

import numpy as np
import numpy.typing as npt
import scipy

NEIGHBOURS = 10
"""How many nearest points 2-opt tries to put next to each point."""


def strips(x_m: npt.NDArray[np.float64], y_m: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
    """An order in boustrophedon strips: up one strip, down the next. Shape (N,).

    On a square, about sqrt(N / 3) strips balance steps along and across; of some numbers of strips, upright and level,
    the one with the shortest path is taken. Within 10 % of 2-opt in settling time.
    """
    width_m, height_m = max(float(np.ptp(x_m)), 1e-12), max(float(np.ptp(y_m)), 1e-12)
    orders = []
    for share in (2.5, 3.0, 3.5):
        orders.append(_in_strips(x_m, y_m, max(1, round(math.sqrt(len(x_m) * width_m / height_m / share)))))
        orders.append(_in_strips(y_m, x_m, max(1, round(math.sqrt(len(x_m) * height_m / width_m / share)))))
    lengths_m = [float(np.maximum(np.abs(np.diff(x_m[o])), np.abs(np.diff(y_m[o]))).sum()) for o in orders]
    return orders[int(np.argmin(lengths_m))]


def _in_strips(across: npt.NDArray[np.float64], along: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.intp]:
    width = max(float(np.ptp(across)), 1e-12) / count
    strip = np.minimum(((across - across.min()) / width).astype(np.intp), count - 1)
    return np.lexsort((np.where(strip % 2 == 0, along, -along), strip))


def two_opt(x_m: npt.NDArray[np.float64], y_m: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
    """`strips`, then improved by reversing parts of the path while that shortens it (2-opt with neighbour lists and
    don't-look bits, Bentley 1992). Seconds for some thousand points."""
    order = strips(x_m, y_m)
    count = len(order)
    if count < 4:
        return order
    x: list[float] = x_m[order].tolist()
    y: list[float] = y_m[order].tolist()
    places = np.column_stack([x, y])
    _, near = scipy.spatial.KDTree(places).query(places, min(NEIGHBOURS + 1, count), p=np.inf)
    near_lists: list[list[int]] = np.asarray(near)[:, 1:].tolist()
    path, place = list(range(count)), list(range(count))

    def length(a: int, b: int) -> float:
        return max(abs(x[a] - x[b]), abs(y[a] - y[b]))

    def reverse(first: int, last: int) -> None:
        path[first : last + 1] = path[first : last + 1][::-1]
        for at in range(first, last + 1):
            place[path[at]] = at

    def improve(a: int) -> list[int]:
        """Tries to give `a` a nearer neighbour; the points whose neighbours changed."""
        for step in (1, -1):
            i = place[a]
            if not 0 <= i + step < count:
                continue
            b = path[i + step]
            now = length(a, b)
            for c in near_lists[a]:
                gain = now - length(a, c)
                if gain <= 0:
                    break
                j = place[c]
                if not 0 <= j + step < count:
                    # c ends the path: the part between turns round, and only one edge is replaced
                    first, last = (i + 1, j) if step == 1 else (j, i - 1)
                    reverse(first, last)
                    return [a, b, c]
                d = path[j + step]
                if gain + length(c, d) - length(b, d) > 1e-12:
                    first, last = (min(i, j) + 1, max(i, j)) if step == 1 else (min(i, j), max(i, j) - 1)
                    reverse(first, last)
                    return [a, b, c, d]
        return []

    todo = list(range(count))
    queued = [True] * count
    while todo:
        a = todo.pop()
        queued[a] = False
        for changed in improve(a):
            if not queued[changed]:
                queued[changed] = True
                todo.append(changed)
    return order[np.array(path, dtype=np.intp)]
