"""Between time t and its square: the change of variable after which light transport is a convolution."""

import scipy.sparse
import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.recon.transport.conventions import Conventions, check_supported
from nlos.recon.transport.linear import AlongTime, linear
from nlos.recon.transport.resampling_matrix import resampling_matrix


class LightConeResampling(nn.Module):
    """(B, C, T, H, W) over equal bins of t -> (B, C, V, H, W) over equal cells of v = t^2, 0 to the last bin's end.

    Cell i holds the integral of x(t) dt over its extent, which is that of x dv / (2 t); the adjoint gives each bin the
    mean of the cells it meets. Both are scaled by 2 / V.
    Source: O'Toole et al. 2018, supplement; closed form instead of their repeated halving, any number of bins.
    """

    def __init__(self, time: TimeAxis, conventions: Conventions = "physical") -> None:
        super().__init__()
        check_supported(time, conventions)
        self.matrix = resampling_matrix(time, conventions)
        self._to_cells, self._to_bins = AlongTime(self.matrix), AlongTime(scipy.sparse.csr_array(self.matrix.T))
        self.cells, self.bins = self.matrix.shape

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """From time to its square."""
        return linear(x, self._to_cells, self._to_bins)

    def adjoint(self, y: torch.Tensor) -> torch.Tensor:
        """From the square of time back to time."""
        return linear(y, self._to_bins, self._to_cells)
