"""Histograms some at a time: what is computed of each takes many times its memory, and a whole scan may fill it."""

from collections.abc import Iterator
from typing import TypeVar

import numpy as np
import numpy.typing as npt

Scalar = TypeVar("Scalar", bound=np.generic)
_POINTS = 256


def some_at_a_time(points: int, together: int = _POINTS) -> Iterator[slice]:
    """Slices of so many of the points, one after the other."""
    return (slice(first, first + together) for first in range(0, points, together))


def chosen(values: npt.NDArray[Scalar], which: npt.NDArray[np.bool_]) -> npt.NDArray[Scalar]:
    """`values` (N, ...) of the points in `which` (N,): without a copy where that is all of them."""
    return values if which.all() else values[which]


def sums_from(counts: npt.NDArray[np.generic], first_bins: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Counts (N, T) in the bins from each of `first_bins` (B,) up to the next, (N, B)."""
    total = np.zeros((len(counts), len(first_bins)))
    for some in some_at_a_time(len(counts)):
        total[some] = np.add.reduceat(counts[some], first_bins, axis=1, dtype=np.float64)
    return total
