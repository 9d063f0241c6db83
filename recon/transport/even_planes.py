"""Filters that are even in both lateral frequencies, on small planes: cosines and sines as matrix products.

An even filter keeps apart what is even and what is odd about the middle of a plane. Each of the four parts has a
quarter of the pixels and a real transform; the padded planes never exist. On NumPy arrays.
"""

import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from nlos.recon.transport.fourier import each

Weights = Callable[[slice], Sequence[npt.NDArray[Any]]]
"""Some frequencies along the first axis -> filters' quadrants (N or 1, f, Y // 2 + 1, X // 2 + 1), one a result."""

LARGEST = 64
"""Pixels a side up to which products are faster than transforms."""
BLOCK = 32
"""Frequencies at a time: what stays in a core's own cache, and is wide enough for a product."""


def small_enough(rows: int, cols: int) -> bool:
    """Whether planes of that many pixels are best filtered here."""
    return max(rows, cols) <= LARGEST and rows % 2 == 0 and cols % 2 == 0


def filter_even(x: npt.NDArray[Any], padded: tuple[int, int, int], weights: Weights) -> list[npt.NDArray[Any]]:
    """x (N, V, H, W) by every filter of `weights`, zero-padded to `padded` (V, Y, X), all even: arrays like x."""
    spectrum = _spectrum(x, padded[0])
    samples, half, frequencies = len(x), spectrum.shape[3:5], spectrum.shape[-1]
    blocks = [slice(first, min(first + BLOCK, frequencies)) for first in range(0, frequencies, BLOCK)]
    waves = [_waves(n, size, x.dtype.str) for n, size in zip(x.shape[2:], padded[1:], strict=True)]
    back = [_waves_back(n, size, x.dtype.str) for n, size in zip(x.shape[2:], padded[1:], strict=True)]
    rows, cols = padded[1] // 2, padded[2] // 2
    done: list[npt.NDArray[Any]] = []
    own = threading.local()

    def work(planes: slice) -> None:
        count = planes.stop - planes.start
        if not hasattr(own, "room"):
            own.room = [np.empty(lines * cols * 2 * BLOCK, x.dtype) for lines in (half[0], rows, rows)]
        along, both, weighted = (
            part[: lines * cols * 2 * count].reshape(lines, cols, 2 * count)
            for part, lines in zip(own.room, (half[0], rows, rows), strict=True)
        )
        quadrants = [np.moveaxis(quadrant, 1, -1) for quadrant in weights(planes)]  # (N or 1, Y, X, f)
        done[:] = done or [spectrum, *(np.empty_like(spectrum) for _ in quadrants[1:])]
        for y, x_, n in np.ndindex(2, 2, samples):
            np.matmul(waves[1][x_], spectrum[y, x_, n, ..., planes].view(x.dtype), out=along)
            np.matmul(waves[0][y], along.swapaxes(0, 1), out=both.swapaxes(0, 1))
            for filtered, quadrant in zip(done, quadrants, strict=True):
                here = quadrant[n % len(quadrant), y : rows + y, x_ : cols + x_]
                np.multiply(both.view(spectrum.dtype), here, out=weighted.view(spectrum.dtype))
                np.matmul(back[0][y], weighted.swapaxes(0, 1), out=along.swapaxes(0, 1))
                np.matmul(back[1][x_], along, out=filtered[y, x_, n, ..., planes].view(x.dtype))

    work(blocks[0])
    each(work, blocks[1:], x)
    return [_joined(filtered, padded[0], x.shape[1]) for filtered in done]


def _spectrum(x: npt.NDArray[Any], padded: int) -> npt.NDArray[Any]:
    """(N, V, H, W) -> (2, 2, N, H / 2, W / 2, F): what is even and odd about the middle of H and of W, from there on,
    transformed along V."""
    samples, cells, rows, cols = x.shape
    made = np.empty((2, 2, samples, rows // 2, cols // 2, padded // 2 + 1), np.result_type(x.dtype, np.complex64))

    def work(at: tuple[int, int]) -> None:
        sample, row = at
        below, above = x[sample, :, rows // 2 + row], x[sample, :, rows // 2 - 1 - row]  # (V, W)
        parts = np.empty((2, 2, cols // 2, cells), x.dtype)
        for odd, both in enumerate((below + above, below - above)):
            right, left = both[:, cols // 2 :].T, both[:, cols // 2 - 1 :: -1].T
            np.add(right, left, out=parts[odd, 0])
            np.subtract(right, left, out=parts[odd, 1])
        made[:, :, sample, row] = scipy.fft.rfft(parts, n=padded, axis=-1)

    each(work, list(np.ndindex(samples, rows // 2)), x)
    return made


def _joined(spectrum: npt.NDArray[Any], padded: int, cells: int) -> npt.NDArray[Any]:
    """The reverse of `_spectrum`, the first `cells` of it."""
    _, _, samples, rows, cols, _ = spectrum.shape
    made = np.empty((samples, cells, 2 * rows, 2 * cols), spectrum.real.dtype)

    def work(at: tuple[int, int]) -> None:
        sample, row = at
        parts = scipy.fft.irfft(spectrum[:, :, sample, row], n=padded, axis=-1)[..., :cells]  # (2, 2, W / 2, V)
        line = np.empty((2, 2 * cols, cells), parts.dtype)  # even and odd along H
        np.add(parts[:, 0], parts[:, 1], out=line[:, cols:])
        np.subtract(parts[:, 0, ::-1], parts[:, 1, ::-1], out=line[:, :cols])
        np.add(line[0].T, line[1].T, out=made[sample, :, rows + row])
        np.subtract(line[0].T, line[1].T, out=made[sample, :, rows - 1 - row])

    each(work, list(np.ndindex(samples, rows)), spectrum)
    return made


@lru_cache(maxsize=16)
def _waves(count: int, padded: int, kind: str) -> npt.NDArray[Any]:
    """(2, padded / 2, count / 2): cosines of the frequencies from 0 on and sines of those from 1 on, at pixels beyond
    the middle of `count`."""
    at, number = np.arange(count // 2) + 0.5, np.arange(padded // 2)[:, None]
    phase = 2 * np.pi / padded * at
    return np.stack([np.cos(number * phase), np.sin((number + 1) * phase)]).astype(kind)


@lru_cache(maxsize=16)
def _waves_back(count: int, padded: int, kind: str) -> npt.NDArray[Any]:
    """(2, count / 2, padded / 2): from these waves' coefficients back to the pixels."""
    share = np.full((2, padded // 2, 1), 2 / padded)
    share[0, 0] = share[1, -1] = 1 / padded  # the mean and the Nyquist frequency, of which there is one
    waves = _waves(count, padded, "<f8") * share
    return np.ascontiguousarray(waves.transpose(0, 2, 1)).astype(kind)
