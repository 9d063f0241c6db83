"""The matrix between time t and its square.

Sparse and in closed form: a cell of t^2 collects the parts of the time bins that lie in it, about two per cell.
"""

from functools import lru_cache

import numpy as np
import scipy

from nlos.acquisition.transient import TimeAxis
from nlos.recon.transport.conventions import Conventions


@lru_cache(maxsize=16)
def resampling_matrix(time: TimeAxis, conventions: Conventions) -> "scipy.sparse.csr_array":
    """The matrix (V, T) of `LightConeResampling`, float64."""
    if conventions == "authors":
        bins = time.bins
        x = np.arange(1, bins * bins + 1)
        cell, column, weight = (x - 1) // bins, np.ceil(np.sqrt(x)).astype(np.int64) - 1, x**-0.5 / bins
        return scipy.sparse.csr_array((weight, (cell, column)), shape=(bins, bins))
    start = time.start_s / time.bin_width_s
    end = start + time.bins
    cells = int(np.ceil(end))
    bin_edges = np.maximum(start + np.arange(time.bins + 1), 0.0)  # in bins; light cannot arrive before it left
    cell_edges = end * np.sqrt(np.arange(cells + 1) / cells)
    edges = np.unique(np.concatenate([bin_edges, cell_edges[cell_edges >= bin_edges[0]]]))
    middle = (edges[1:] + edges[:-1]) / 2
    cell = np.clip((middle / end) ** 2 * cells, 0, cells - 1).astype(np.int64)
    column = np.clip(middle - start, 0, time.bins - 1).astype(np.int64)
    return scipy.sparse.csr_array((2 * np.diff(edges) / end, (cell, column)), shape=(cells, time.bins))
