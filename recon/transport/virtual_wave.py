"""A virtual wave packet sent through the transients: the first step of the phasor field in light-cone space.

The approximation that the f-k programs ship beside migration (Lindell et al. 2019, after Liu et al., Nature 572,
2019): convolve in time, then back-project on the light cone and take the magnitude.
"""

import numpy as np
import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.recon.transport.conventions import Conventions, speed_m_per_s
from nlos.recon.transport.fourier import good_size
from nlos.recon.transport.linear import linear


class VirtualWave(nn.Module):
    """Convolves each transient in time with a virtual wave packet: (B, C, T, H, W) real -> complex.

    Under `physical` the packet is centred, sigma = cycles * wavelength / 6; under `authors` as in the f-k programs: a
    whole number of bins long, Gaussian of 0.3 of its half length, and half a bin off where that number is even.
    """

    def __init__(
        self, time: TimeAxis, wavelength_m: float, cycles: float, conventions: Conventions = "physical"
    ) -> None:
        super().__init__()
        bin_m = time.bin_width_s * speed_m_per_s(conventions)
        if conventions == "authors":
            length = round(cycles * wavelength_m / bin_m)
            cycles_inside = length * bin_m / wavelength_m
            from_middle = (np.arange(length) - (length - 1) / 2) / ((length - 1) / 2)
            phase = 2 * np.pi * cycles_inside * np.arange(1, length + 1) / length
            self.packet = np.exp(1j * phase) * np.exp(-0.5 * (from_middle / 0.3) ** 2)
            self.origin = int(np.ceil((length - 1) / 2))
        else:
            sigma_m = cycles * wavelength_m / 6
            self.origin = int(np.ceil(3 * sigma_m / bin_m))
            offset_m = np.arange(-self.origin, self.origin + 1) * bin_m
            self.packet = np.exp(2j * np.pi * offset_m / wavelength_m - 0.5 * (offset_m / sigma_m) ** 2)
        self.bins = time.bins

    def forward(self, transient: torch.Tensor) -> torch.Tensor:
        """The phasors at the wall."""
        return linear(transient, self._convolved, self._correlated)

    def adjoint(self, phasors: torch.Tensor) -> torch.Tensor:
        """The transpose over the real numbers: complex -> real."""
        return linear(phasors, self._correlated, self._convolved)

    def _spectrum(self, like: torch.Tensor) -> torch.Tensor:
        size = good_size(self.bins + len(self.packet) - 1)
        spectrum = torch.from_numpy(
            np.fft.fft(np.roll(np.pad(self.packet, (0, size - len(self.packet))), -self.origin))
        )
        double = like.dtype in (torch.float64, torch.complex128)
        return spectrum.to(like.device, torch.complex128 if double else torch.complex64)[:, None, None]

    def _convolved(self, transient: torch.Tensor) -> torch.Tensor:
        packet = self._spectrum(transient)
        spectrum = torch.fft.fft(transient.detach(), n=len(packet), dim=2)
        phasors: torch.Tensor = torch.fft.ifft(spectrum * packet, dim=2)[:, :, : self.bins]
        return phasors

    def _correlated(self, phasors: torch.Tensor) -> torch.Tensor:
        packet = self._spectrum(phasors)
        spectrum = torch.fft.fft(phasors.detach(), n=len(packet), dim=2)
        transient: torch.Tensor = torch.fft.ifft(spectrum * packet.conj(), dim=2)[:, :, : self.bins].real
        return transient
