"""The instrument's response as an operator on the light cone, for methods that need a forward model."""

import scipy.sparse
import torch
from torch import nn

from nlos.recon.transport.linear import linear
from nlos.recon.transport.response_bands import Bands


class ResponseOnCone(nn.Module):
    """(B, C, V, H, W) light on the cone -> the same as the instrument records it: in each band of time a convolution.

    The matrix of `LightConeResampling` (V, T) carries the bands' windows to the cells; `padded` is the length of the
    transform along v.
    """

    def __init__(self, bands: Bands, matrix: scipy.sparse.csr_array, padded: int) -> None:
        super().__init__()
        self.padded, self.cells = padded, matrix.shape[0]
        weights = torch.from_numpy(matrix @ bands.windows.T).T  # (N, V)
        self.weights = weights / weights.sum(dim=0).clamp(min=1e-12)
        self.spectra = torch.from_numpy(bands.spectra)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """What is recorded of light `x`."""
        return linear(x, self._spread, self._gathered)

    def adjoint(self, y: torch.Tensor) -> torch.Tensor:
        """Every record to the instants that it may be of."""
        return linear(y, self._gathered, self._spread)

    def _spread(self, x: torch.Tensor) -> torch.Tensor:
        spectrum = torch.fft.rfft(x, n=self.padded, dim=2)
        total = torch.zeros_like(x)
        for weight, k in self._bands(x):
            total += weight * torch.fft.irfft(spectrum * k, n=self.padded, dim=2)[:, :, : x.shape[2]]
        return total

    def _gathered(self, y: torch.Tensor) -> torch.Tensor:
        total = torch.zeros((), dtype=y.dtype.to_complex(), device=y.device)
        for weight, k in self._bands(y):
            total = total + torch.fft.rfft(weight * y, n=self.padded, dim=2) * k.conj()
        whole: torch.Tensor = torch.fft.irfft(total, n=self.padded, dim=2)
        return whole[:, :, : y.shape[2]]

    def _bands(self, like: torch.Tensor) -> list[tuple[torch.Tensor, torch.Tensor]]:
        weights = self.weights.to(like.device, like.dtype)[:, :, None, None]
        spectra = self.spectra.to(like.device, like.dtype.to_complex())[:, :, None, None]
        return list(zip(weights, spectra, strict=True))
