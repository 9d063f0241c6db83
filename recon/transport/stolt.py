"""Stolt's migration of a wave field, on NumPy arrays or tensors.

Source: Lindell, Wetzstein, O'Toole, ACM TOG 38(4), 2019; Stolt 1978. A real FFT along time gives exactly the half
spectrum that migration uses, and both lateral frequencies stay on the grid, so Stolt's change of variable from time
frequency to depth frequency is a one-dimensional interpolation.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport.conventions import Conventions, check_supported, speed_m_per_s
from nlos.recon.transport.fourier import Array, beside, cast, each, fft, good_size, half_spectrum, ifft

PLANES_AT_ONCE = 8
TAPS = 3  # frequencies that one is interpolated from
STEEP = 6.2  # of the kernel exp(STEEP (sqrt(1 - (2 u / TAPS)^2) - 1)): within 1 % wherever a frequency falls


class StoltMigration:
    """Real field at the wall (T, H, W) -> complex field at time 0 (D, H, W), one plane a bin.

    Under `physical`, samples lie at bin centres, and the interpolation is done about the middle of the window, by a
    kernel whose own shape over time is divided out (Barnett, Magland, af Klinteberg, SIAM J. Sci. Comput. 41, 2019);
    under `authors` it is linear, as published.
    """

    def __init__(self, wall: WallGrid, time: TimeAxis, conventions: Conventions = "physical") -> None:
        check_supported(time, conventions)
        self.wall, self.time, self.conventions = wall, time, conventions
        if conventions == "authors":
            self.padded = (2 * time.bins, 2 * wall.rows, 2 * wall.cols)
            self.first, self.middle = 0.0, 0.0
        else:
            self.padded = (good_size(2 * time.bins), good_size(2 * wall.rows), good_size(2 * wall.cols))
            self.first = time.start_s / time.bin_width_s + 0.5  # where sample 0 lies, in bins
            self.middle = (time.bins - 1) / 2  # of the window, in samples
        # One lateral cycle on the padded wall is as many cycles on the padded depth axis.
        depth_m = self.padded[0] * time.bin_width_s * speed_m_per_s(conventions) / 2
        self.per_row_cycle = depth_m / (wall.height_m / wall.rows * self.padded[1])
        self.per_col_cycle = depth_m / (wall.width_m / wall.cols * self.padded[2])

    def migrate(self, field: Array) -> Array:
        """The migrated wave of one field (T, H, W), complex (D, H, W)."""
        spectrum = half_spectrum((field * self.gain(field))[None], self.padded[0], self.padded[1])[0]  # (F, Y, W)
        spectrum *= self.about_middle(spectrum)
        return self._to_depth(self.stolt(spectrum, gather))

    def gain(self, like: Array) -> Array:
        """Interpolation between frequencies fades what is far from the middle of the window; undone here."""
        if self.conventions == "authors":
            return beside(like, np.ones(self.time.bins))[:, None, None]
        from_middle = (np.arange(self.time.bins) - self.middle) / self.padded[0]
        place = (np.arange(100) + 0.5) / 100 * TAPS - TAPS / 2
        shape = np.cos(2 * np.pi * from_middle[:, None] * place) @ _kernel(place) * (TAPS / 100)
        return beside(like, 1 / shape)[:, None, None]

    def about_middle(self, like: Array) -> Array:
        """Moves time 0 to the middle of the window, about which the spectrum is smoothest; (F, 1, 1)."""
        cycles = np.arange(self.padded[0] // 2 + 1) * (self.middle / self.padded[0])
        return beside(like, np.exp(2j * np.pi * cycles))[:, None, None]

    def _to_depth(self, spectrum: Array) -> Array:
        """Half spectrum along depth (F, Y, W) -> complex field (D, H, W): in its place, a row at a time."""
        planes, rows = self.time.bins, self.wall.rows

        def work(row: int) -> None:
            spectrum[:planes, row] = ifft(spectrum[:, row], 0, self.padded[0])[:planes]

        each(work, range(rows), spectrum)
        return spectrum[:planes, :rows]

    def stolt(self, spectrum: Array, move: Callable[[Array, Array, list[Array], Array], Array]) -> Array:
        """Time frequency -> depth frequency of (F, Y, W) by `gather`, back by its transpose `scatter`; in place."""
        cols = spectrum.shape[2]
        wide = spectrum

        def across(planes: slice) -> None:
            wide[planes] = fft(wide[planes], 1)

        def work(ky: int) -> None:
            first, weights, factor = self._table(ky, wide)
            for row in {ky, -ky % self.padded[1]}:
                plane = fft(wide[:, row], 1, self.padded[2])  # (F, X)
                wide[:, row] = ifft(move(plane, first, weights, factor), 1)[:, :cols]

        def back(planes: slice) -> None:
            wide[planes] = ifft(wide[planes], 1)

        some = [slice(first, first + PLANES_AT_ONCE) for first in range(0, len(wide), PLANES_AT_ONCE)]
        each(across, some, wide)
        each(work, range(self.padded[1] // 2 + 1), wide)
        each(back, some, wide)
        return spectrum

    def _table(self, ky: int, like: Array) -> tuple[Array, list[Array], Array]:
        """For a row of lateral frequencies, (F, X): flat index of the first tap, each tap's weight and a factor."""
        xp: Any
        place: dict[str, Any]
        if isinstance(like, np.ndarray):
            xp, place = np, {}
        else:
            import torch

            xp, place = torch, {"device": like.device}
        frequencies, last = like.shape[0], like.shape[0] - (2 if self.conventions == "authors" else 1)
        kz = xp.arange(frequencies, dtype=xp.float64, **place)[:, None]
        kx = xp.arange(self.padded[2] // 2 + 1, dtype=xp.float64, **place)
        source = (kz**2 + (self.per_col_cycle * kx) ** 2 + (self.per_row_cycle * ky) ** 2) ** 0.5
        linear = self.conventions == "authors"
        taps = 2 if linear else TAPS
        first = xp.clip(xp.floor(source - taps / 2 + 1), 0, frequencies - taps)
        cycles = (kz * self.first - source * (self.first + self.middle)) / self.padded[0]
        real = "float64" if like.itemsize == 16 else "float32"
        angle = cast(2 * xp.pi * (cycles - xp.floor(cycles)), real)
        jacobian = cast((source <= last) * kz / xp.clip(source, 1e-6, None), real)
        factor = jacobian * (xp.cos(angle) + 1j * xp.sin(angle))
        col = xp.arange(self.padded[2], **place)
        mirrored = xp.minimum(col, self.padded[2] - col)
        index = cast(first, "int64")[:, mirrored] * self.padded[2] + col
        after = cast(source - first, real)
        weights = [1 - abs(after - tap) if linear else _kernel(after - tap, xp) for tap in range(taps)]
        return index, [weight[:, mirrored] for weight in weights], factor[:, mirrored]


def _kernel(place: Array, xp: Any = np) -> Array:
    """What a tap weighs at a distance of so many frequencies; `xp` is NumPy or torch."""
    inside = (1 - place * place * (2 / TAPS) ** 2).clip(0)
    return xp.exp(STEEP * (xp.sqrt(inside) - 1)) * (inside > 0)


def gather(plane: Array, first: Array, weights: list[Array], factor: Array) -> Array:
    """The weighted sum of as many neighbours along the first axis of `plane` (F, X), then times `factor`."""
    flat = plane.reshape(-1)
    total = flat[first]
    total *= weights[0]
    for tap, weight in enumerate(weights[1:], 1):
        neighbour = flat[first + tap * plane.shape[1]]
        neighbour *= weight
        total += neighbour
    total *= factor
    return total


def scatter(plane: Array, first: Array, weights: list[Array], factor: Array) -> Array:
    """The conjugate transpose of `gather`."""
    value = plane * factor.conj()
    index = [(first + tap * plane.shape[1]).reshape(-1) for tap in range(len(weights))]
    parts = [(value * weight).reshape(-1) for weight in weights]
    if isinstance(plane, np.ndarray):
        real, imaginary = (
            sum(
                np.bincount(i, weights=getattr(part, name), minlength=plane.size)
                for i, part in zip(index, parts, strict=True)
            )
            for name in ("real", "imag")
        )
        return np.asarray(real + 1j * imaginary, dtype=plane.dtype).reshape(plane.shape)
    import torch

    moved = torch.zeros(plane.numel(), 2, dtype=weights[0].dtype, device=plane.device)
    for i, part in zip(index, parts, strict=True):
        moved.index_add_(0, i, torch.view_as_real(part))
    return torch.view_as_complex(moved).reshape(plane.shape)
