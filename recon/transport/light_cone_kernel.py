"""The light cone's transfer function, from the geometry: exact and separable, or as published.

delta(v - x^2 - y^2), integrated over a wall pixel, becomes under a Fourier transform along v exp(-i w x^2)
exp(-i w y^2): a product of two Fresnel chirps. The spectrum of the kernel is therefore, for each frequency along v, an
outer product of two short vectors; nothing three-dimensional is ever built.
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport.conventions import Conventions, range_m
from nlos.recon.transport.fourier import good_size
from nlos.recon.transport.resampling_matrix import resampling_matrix

Spectrum = npt.NDArray[np.complex128]


def padded_cells(wall: WallGrid, time: TimeAxis, conventions: Conventions = "physical") -> int:
    """The padded length along v: cells of `LightConeResampling`, and the largest delay between two wall points."""
    cells = resampling_matrix(time, conventions).shape[0]
    if conventions == "authors":
        return 2 * cells
    pitches = _pitches(wall, time, cells)
    # Offsets whose delay alone is beyond the last cell are never seen together.
    delays = [
        min(((count - 1) * pitch) ** 2, cells) for count, pitch in zip((wall.rows, wall.cols), pitches, strict=True)
    ]
    return good_size(cells + int(np.ceil(sum(delays))) + 1)


@lru_cache(maxsize=8)
def chirps(wall: WallGrid, time: TimeAxis, cells: int) -> tuple[tuple[int, int, int], Spectrum, Spectrum]:
    """The padded size (P, Y, X) and the spectra of both chirps, (F, Y // 2 + 1) and (F, X // 2 + 1), complex128."""
    pitches = _pitches(wall, time, cells)
    padded_v = padded_cells(wall, time)
    cycles = np.arange(padded_v // 2 + 1) / padded_v  # per cell
    spectra, powers = [], []
    for count, pitch in zip((wall.rows, wall.cols), pitches, strict=True):
        padded = good_size(2 * count)
        # Farther offsets than the wall's are never seen together, but the inverse needs the kernel there: one that
        # ends abruptly has nulls in its spectrum, which come back as a veil at small depths.
        offset = np.arange(padded // 2 + 1, dtype=np.float64) * pitch
        chirp = _fresnel_integral(offset - pitch / 2, offset + pitch / 2, 2 * np.pi * cycles[:, None]) / pitch
        chirp[:, offset**2 > cells] = 0
        chirp *= np.sinc(cycles)[:, None]  # albedo and counts are means over cells: one factor for each, shared by both
        kernel = np.zeros((len(cycles), padded), dtype=np.complex128)
        kernel[:, : padded // 2 + 1] = chirp
        kernel[:, padded // 2 :] += chirp[:, :0:-1]
        spectrum = scipy.fft.fft(kernel, axis=1)
        powers.append(np.mean(np.abs(spectrum) ** 2, axis=1))
        spectra.append((padded, spectrum[:, : padded // 2 + 1]))
    both_sides = np.full(len(cycles), 2.0)
    both_sides[[0, -1]] = 1
    norm = np.sqrt(np.sum(powers[0] * powers[1] * both_sides) / padded_v)
    (rows, rows_spectrum), (cols, cols_spectrum) = spectra
    return (padded_v, rows, cols), rows_spectrum / norm, cols_spectrum


def _pitches(wall: WallGrid, time: TimeAxis, cells: int) -> tuple[float, float]:
    """A wall pixel's height and width, in square roots of a cell."""
    cell_m = range_m(time, "physical") / cells**0.5
    return wall.height_m / wall.rows / cell_m, wall.width_m / wall.cols / cell_m


def _fresnel_integral(
    a: npt.NDArray[np.float64], b: npt.NDArray[np.float64], w: npt.NDArray[np.float64]
) -> npt.NDArray[np.complex128]:
    """The integral of exp(-i w x^2) from a to b, w >= 0."""
    scale = np.sqrt(2 * np.maximum(w, 1e-12) / np.pi)
    (sine_a, cosine_a), (sine_b, cosine_b) = scipy.special.fresnel(scale * a), scipy.special.fresnel(scale * b)
    return np.asarray(((cosine_b - cosine_a) - 1j * (sine_b - sine_a)) / scale, dtype=np.complex128)


@lru_cache(maxsize=2)
def published_transfer(wall: WallGrid, time: TimeAxis) -> npt.NDArray[np.complex64]:
    """The published kernel's spectrum, (M + 1, 2 H, 2 W): one voxel a column, half a sample off towards +row, -col."""
    cells = time.bins
    reach = range_m(time, "authors")
    y = np.linspace(-1, 1, 2 * wall.rows) * (wall.height_m / reach)
    x = np.linspace(-1, 1, 2 * wall.cols) * (wall.width_m / reach)
    delay = np.linspace(0, 2, 2 * cells)
    nearest = np.stack([np.abs((row**2 + x**2)[:, None] - delay).argmin(-1) for row in y])
    kernel = np.zeros((2 * cells, 2 * wall.rows, 2 * wall.cols), dtype=np.float32)
    rows, cols = np.indices(nearest.shape)
    kernel[nearest, rows, cols] = 1 / np.sqrt(nearest.size)
    kernel = np.roll(kernel, (wall.rows, wall.cols), axis=(1, 2))
    mirrored = np.roll(kernel[:, :, ::-1], 1, axis=2)  # they scan columns from the right
    return np.asarray(scipy.fft.rfftn(mirrored, axes=(1, 2, 0)), dtype=np.complex64)
