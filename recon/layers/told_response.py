"""The instrument's response as a network is told it, and the times between which it is taken."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nlos.acquisition.response import GAUSSIAN_WIDTHS
from nlos.acquisition.transient import TimeAxis
from nlos.recon.transport.response_bands import spectra

BANDS = 3  # of time, in which the response is inverted
MIDDLE = slice(BANDS // 2, BANDS // 2 + 1)  # of them, where one has to do


@dataclass(frozen=True)
class Told:
    """What an instant of light becomes: shares a bin, K odd, the middle one on time; a lone 1 is no response.

    `knots_s` are times between which it is interpolated over the squares of time, from the first light on.
    """

    taps: Tensor  # (B, K)
    bin_width_s: float
    knots_s: list[npt.NDArray[np.float64]]  # B times (BANDS,)

    def spectra(self, time: TimeAxis, cells: int, padded: int) -> Tensor:
        """(B, BANDS, F) along the squares of `time`; see `response_bands.spectra`."""
        each = [
            spectra(knots_s, taps, self.bin_width_s, time, cells, padded)
            for knots_s, taps in zip(self.knots_s, self.taps.cpu().double().numpy(), strict=True)
        ]
        return torch.from_numpy(np.stack(each)).to(self.taps.device)

    @property
    def width_s(self) -> Tensor:
        """(B,) the FWHM of a Gaussian that is as concentrated as this, 0 for a lone 1."""
        concentrated = 1 / self.taps.square().sum(dim=1).clamp(min=1e-12)
        return (concentrated.square() - 1).clamp(min=0).sqrt() * self.bin_width_s / GAUSSIAN_WIDTHS
