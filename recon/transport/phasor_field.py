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

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport.fourier import Array, array_of, each, fft, good_size, ifft
from nlos.recon.transport.linear import linear

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
        cycles_per_m = frequencies_per_m(time, wavelength_m, cycles)
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
            folded = _folded(fft(fft(array_of(phasors), 2, self.padded[1]), 1, self.padded[0]))
            seen = array_of(field)

            def work(plane: int, folded: Array = folded, seen: Array = seen) -> None:
                kernel = self._filter(plane, folded)
                focused = _unfolded(kernel.reshape(-1, 1, kernel.shape[2]) @ folded, self.padded)
                seen[plane] = ifft(ifft(focused, 0)[:rows], 1)[:, :cols]

            each(work, range(len(self.depths_m)), seen)
            fields.append(field)
        return torch.stack(fields).reshape(*transient.shape[:2], *fields[0].shape)

    def _back(self, field: torch.Tensor) -> torch.Tensor:
        rows, cols = self.wall.rows, self.wall.cols
        transients = []
        for sample in field.detach().reshape(-1, len(self.depths_m), rows, cols):
            seen = array_of(sample)
            spectra: Array = 0  # (Y, X, K)
            for plane in range(len(self.depths_m)):
                spectrum = fft(fft(seen[plane], 1, self.padded[1]), 0, self.padded[0])
                spectra = spectra + _whole(self._filter(plane, spectrum).conj(), self.padded) * spectrum[..., None]
            phasors = torch.as_tensor(ifft(ifft(spectra, 0)[:rows], 1)[:, :cols], device=sample.device)
            analysis = self._analysis(phasors.real)
            real, imaginary = (part.permute(2, 0, 1) for part in (phasors.real, phasors.imag))
            transients.append(
                torch.tensordot(analysis.real.T, real, dims=1) + torch.tensordot(analysis.imag.T, imaginary, dims=1)
            )
        return torch.stack(transients).reshape(*field.shape[:2], *transients[0].shape)

    def _analysis(self, like: torch.Tensor) -> torch.Tensor:
        complex_kind = torch.complex128 if like.dtype == torch.float64 else torch.complex64
        return torch.from_numpy(self.analysis).to(like.device, complex_kind)

    def _filter(self, plane: int, like: Array) -> Array:
        """The kernel's spectra at one depth, all frequencies: the quadrant (Y // 2 + 1, X // 2 + 1, K)."""
        key = (plane, str(like.dtype), str(getattr(like, "device", "cpu")))
        if self._filters is not None and key in self._filters:
            return self._filters[key]
        distance_m = np.sqrt(self.offsets_m2 + self.depths_m[plane] ** 2)
        real = np.float64 if like.dtype in (np.complex128, torch.complex128) else np.float32
        phase = (2 * distance_m).astype(real)[..., None] * self.wavenumbers.astype(real)
        fading = (1 / distance_m**2).astype(real)[..., None]
        if isinstance(like, np.ndarray):
            # An even kernel's FFT is a cosine transform of its quadrant.
            done = np.empty(phase.shape, dtype=like.dtype)
            for part, wave in ((done.real, np.cos(phase)), (done.imag, np.sin(phase, out=phase))):
                wave *= fading
                part[...] = scipy.fft.dctn(wave, type=1, axes=(0, 1), overwrite_x=True)
        else:
            angle = torch.from_numpy(phase).to(like.device)
            kernel = torch.polar(torch.from_numpy(fading).to(like.device).expand(angle.shape).contiguous(), angle)
            spectrum = torch.fft.fft2(_whole(kernel, self.padded), dim=(0, 1))
            done = spectrum[: self.padded[0] // 2 + 1, : self.padded[1] // 2 + 1].contiguous()
        if self._filters is not None:
            self._filters[key] = done
        return done


def frequencies_per_m(time: TimeAxis, wavelength_m: float, cycles: float) -> npt.NDArray[np.float64]:
    """The frequencies of the pulse, in cycles a metre of light path: so close that nothing wraps within the window."""
    sigma_m = cycles * wavelength_m / 6
    spacing = 1 / (SPEED_OF_LIGHT_M_PER_S * time.bin_width_s * (time.bins - 1) + 6 * sigma_m)
    reach = 3 / (2 * np.pi * sigma_m)
    nearest = np.arange(np.ceil((1 / wavelength_m - reach) / spacing), (1 / wavelength_m + reach) / spacing)
    return np.asarray(nearest[nearest > 0] * spacing, dtype=np.float64)


def _folded(spectra: Array) -> Array:
    """(K, Y, X) -> (quadrant's Y * X, K, 4): what an even filter multiplies by the same number, side by side."""
    xp = np if isinstance(spectra, np.ndarray) else torch
    parts = [
        spectra[:, rows][:, :, cols] for rows in _both_ways(spectra.shape[1]) for cols in _both_ways(spectra.shape[2])
    ]
    stacked = xp.stack(parts, -1).reshape(len(spectra), -1, 4)
    return np.ascontiguousarray(stacked.transpose(1, 0, 2)) if xp is np else stacked.permute(1, 0, 2).contiguous()


def _unfolded(products: Array, padded: tuple[int, int]) -> Array:
    """The inverse for one sum over frequencies: (quadrant's Y * X, 1, 4) -> (Y, X)."""
    quadrants = products.reshape(padded[0] // 2 + 1, padded[1] // 2 + 1, 4)
    xp: Any = np if isinstance(products, np.ndarray) else torch
    whole = xp.empty(padded, dtype=products.dtype, **({} if xp is np else {"device": products.device}))
    k = 0
    for rows in _both_ways(padded[0]):
        for cols in _both_ways(padded[1]):
            whole[rows[:, None], cols] = quadrants[..., k]
            k += 1
    return whole


def _both_ways(size: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The indices of the first half of a spectrum, and those of its mirror image."""
    half = np.arange(size // 2 + 1)
    return half, -half % size


def _whole(quadrant: Array, padded: tuple[int, int]) -> Array:
    """The even array (Y, X, K) that a quadrant determines."""
    rows, cols = (np.minimum(np.arange(size), size - np.arange(size)) for size in padded)
    return quadrant[rows][:, cols]
