"""Phasor field: the wall as the aperture of a virtual camera that sends a pulse of waves around the corner.

The confocal Rayleigh-Sommerfeld propagator, frequency by frequency and plane by plane (Liu et al., Nature 572, 2019,
and Nature Communications 11, 2020).
"""

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
import torch
from torch import nn

from acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from acquisition.wall import WallGrid
from recon.transport.fourier import fft, good_size, halves, ifft, in_threads
from recon.transport.linear import linear

KEPT_FILTER_BYTES = 1 << 30  # filters of one geometry are kept between calls up to this; beyond, made as they are used


class ConfocalRsd(nn.Module):
    """Real transient (B, C, T, H, W) -> complex field (B, C, D, H, W) at `depths_m`, when the pulse arrives there.

    The pulse has `wavelength_m` and a Gaussian envelope of sigma = cycles * wavelength / 6; frequencies to +-3 sigma.
    Voxels at the wall points' (x, y). The kernel is (e^(i k d) / d)^2, out and back along the same way.
    """

    def __init__(
        self, wall: WallGrid, time: TimeAxis, depths_m: npt.NDArray[np.float64], wavelength_m: float, cycles: float
    ) -> None:
        super().__init__()
        if not (len(depths_m) and (depths_m > 0).all()):
            raise ValueError("planes must lie in front of the wall: depths above 0 m")
        self.wall, self.time, self.depths_m = wall, time, depths_m
        self.padded = (good_size(2 * wall.rows), good_size(2 * wall.cols))
        path_m = time.centres_s() * SPEED_OF_LIGHT_M_PER_S
        sigma_m = cycles * wavelength_m / 6
        spacing = 1 / (path_m[-1] - path_m[0] + 6 * sigma_m)  # cycles a metre: nothing in the window wraps into it
        reach = 3 / (2 * np.pi * sigma_m)
        nearest = np.arange(np.ceil((1 / wavelength_m - reach) / spacing), (1 / wavelength_m + reach) / spacing)
        cycles_per_m = nearest[nearest > 0] * spacing
        pulse = np.exp(-0.5 * ((cycles_per_m - 1 / wavelength_m) * 2 * np.pi * sigma_m) ** 2)
        self.wavenumbers = 2 * np.pi * cycles_per_m  # of the light path, radians a metre
        self.analysis = pulse[:, None] * np.exp(-1j * self.wavenumbers[:, None] * path_m)  # (K, T)
        half = [size // 2 + 1 for size in self.padded]
        self.offsets_m2 = (np.arange(half[0]) * wall.height_m / wall.rows)[:, None] ** 2 + (
            np.arange(half[1]) * wall.width_m / wall.cols
        ) ** 2
        kept = len(depths_m) * len(self.wavenumbers) * half[0] * half[1] * 8 <= KEPT_FILTER_BYTES
        self._filters: dict[tuple[int, str, str], Any] | None = {} if kept else None

    def forward(self, transient: torch.Tensor) -> torch.Tensor:
        """The field that the virtual camera focuses on each voxel."""
        return linear(transient, self._propagate, self._back)

    def adjoint(self, field: torch.Tensor) -> torch.Tensor:
        """The transpose over the real numbers: (B, C, D, H, W) complex -> (B, C, T, H, W) real."""
        return linear(field, self._back, self._propagate)

    def _propagate(self, transient: torch.Tensor) -> torch.Tensor:
        rows, cols = self.wall.rows, self.wall.cols
        fields = []
        for sample in transient.detach().reshape(-1, self.time.bins, rows, cols):
            analysis = self._analysis(sample)
            phasors = torch.complex(
                torch.tensordot(analysis.real, sample, dims=1), torch.tensordot(analysis.imag, sample, dims=1)
            )
            field = torch.empty((len(self.depths_m), rows, cols), dtype=phasors.dtype, device=phasors.device)
            on_cpu = sample.device.type == "cpu"
            aperture = phasors.numpy() if on_cpu else phasors  # (K, H, W)
            spectra = fft(fft(aperture, self.padded[1], 2), self.padded[0], 1)
            seen = field.numpy() if on_cpu else field

            def work(plane: int, spectra: Any = spectra, seen: Any = seen) -> None:
                focused = _sum_of_products(self._filter(plane, spectra), spectra)
                seen[plane] = ifft(ifft(focused, 0)[:rows], 1)[:, :cols]

            if on_cpu:
                in_threads(work, range(len(self.depths_m)))
            else:
                for plane in range(len(self.depths_m)):
                    work(plane)
            fields.append(field)
        return torch.stack(fields).reshape(*transient.shape[:2], *fields[0].shape)

    def _back(self, field: torch.Tensor) -> torch.Tensor:
        rows, cols = self.wall.rows, self.wall.cols
        transients = []
        for sample in field.detach().reshape(-1, len(self.depths_m), rows, cols):
            seen = sample.numpy() if sample.device.type == "cpu" else sample
            spectra: Any = 0
            for plane in range(len(self.depths_m)):
                spectrum = fft(fft(seen[plane], self.padded[1], 1), self.padded[0], 0)
                spectra = spectra + _whole(self._filter(plane, spectrum).conj(), self.padded) * spectrum
            aperture = ifft(ifft(spectra, 1)[:, :rows], 2)[:, :, :cols]
            phasors = torch.as_tensor(aperture, device=sample.device)
            analysis = self._analysis(phasors.real)
            transients.append(
                torch.tensordot(analysis.real.T, phasors.real, dims=1)
                + torch.tensordot(analysis.imag.T, phasors.imag, dims=1)
            )
        return torch.stack(transients).reshape(*field.shape[:2], *transients[0].shape)

    def _analysis(self, like: torch.Tensor) -> torch.Tensor:
        complex_kind = torch.complex128 if like.dtype == torch.float64 else torch.complex64
        return torch.from_numpy(self.analysis).to(like.device, complex_kind)

    def _filter(self, plane: int, like: Any) -> Any:
        """The kernel's spectra at one depth, all frequencies: the quadrant (K, Y // 2 + 1, X // 2 + 1)."""
        key = (plane, str(like.dtype), str(getattr(like, "device", "cpu")))
        if self._filters is not None and key in self._filters:
            return self._filters[key]
        distance_m = np.sqrt(self.offsets_m2 + self.depths_m[plane] ** 2)
        double = like.dtype in (np.complex128, torch.complex128)
        real = np.float64 if double else np.float32
        phase = self.wavenumbers[:, None, None].astype(real) * (2 * distance_m).astype(real)
        fading = (1 / distance_m**2).astype(real)
        if isinstance(like, np.ndarray):
            # An even kernel's FFT is a cosine transform of its quadrant.
            real_part = scipy.fft.dctn(np.cos(phase) * fading, type=1, axes=(1, 2), overwrite_x=True)
            done = np.empty(phase.shape, dtype=like.dtype)
            done.real = real_part
            done.imag = scipy.fft.dctn(np.sin(phase) * fading, type=1, axes=(1, 2), overwrite_x=True)
        else:
            angle = torch.from_numpy(phase).to(like.device)
            kernel = torch.polar(torch.from_numpy(fading).to(like.device).expand(angle.shape).contiguous(), angle)
            spectrum = torch.fft.fft2(_whole(kernel, self.padded))
            done = spectrum[:, : self.padded[0] // 2 + 1, : self.padded[1] // 2 + 1].contiguous()
        if self._filters is not None:
            self._filters[key] = done
        return done


def _sum_of_products(quadrant: Any, spectra: Any) -> Any:
    """The sum over frequencies of an even filter's quadrant (K, ...) times whole spectra (K, Y, X): (Y, X)."""
    numpy = isinstance(spectra, np.ndarray)
    einsum, flip = (np.einsum, np.flip) if numpy else (torch.einsum, torch.flip)
    result = np.empty(spectra.shape[1:], spectra.dtype) if numpy else torch.empty_like(spectra[0])
    for rows, rows_of in halves(spectra.shape[1]):
        for cols, cols_of in halves(spectra.shape[2]):
            mirrored = tuple(axis for axis, half in ((1, rows), (2, cols)) if half.start)
            part = flip(quadrant[:, rows_of, cols_of], mirrored)
            result[rows, cols] = einsum("kyx,kyx->yx", part, spectra[:, rows, cols])
    return result


def _whole(quadrant: Any, padded: tuple[int, int]) -> Any:
    """The even array (K, Y, X) that a quadrant determines."""
    rows, cols = (np.minimum(np.arange(size), size - np.arange(size)) for size in padded)
    return quadrant[:, rows][:, :, cols]
