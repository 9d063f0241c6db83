"""Filters in the light cone's spectrum, on NumPy arrays or tensors: the convolution with its kernel, or an inverse.

Zero-padded so far that nothing wraps around: twice in space, and along v by the largest delay between two wall points.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport.conventions import Conventions, check_supported
from nlos.recon.transport.even_planes import Weights, filter_even, small_enough
from nlos.recon.transport.fourier import (
    Array,
    Multiply,
    add_signal_,
    beside,
    empty,
    filter_planes_,
    half_spectrum,
    multiply_even_,
)
from nlos.recon.transport.light_cone_kernel import chirps, published_transfer
from nlos.recon.transport.resampling_matrix import resampling_matrix

Gain = Callable[[Any, slice], Any]
"""(|H|^2 at some planes, those planes) -> a real factor; arrays on a CPU, tensors elsewhere."""


class LightConeFilter:
    """The light-cone kernel H over (N, V, H, W), V the cells of `resampling_matrix`; unit L2 norm.

    `tile` frequencies along v are held at once, all unless given; the result is the same.
    """

    def __init__(
        self, wall: WallGrid, time: TimeAxis, conventions: Conventions = "physical", tile: int | None = None
    ) -> None:
        check_supported(time, conventions)
        self.wall, self.time, self.conventions, self.tile = wall, time, conventions, tile
        self.cells = int(resampling_matrix(time, conventions).shape[0])
        if conventions == "authors":
            self.padded = (2 * self.cells, 2 * wall.rows, 2 * wall.cols)
        else:
            self.padded, self._rows, self._cols = chirps(wall, time, self.cells)

    def transfer(self, planes: slice = slice(None)) -> npt.NDArray[np.complexfloating[Any, Any]]:
        """H at `planes` of the half spectrum along v: its quadrant (f, Y // 2 + 1, X // 2 + 1), even in both; float64.

        Of the authors' conventions, whose kernel is not even, the whole (f, Y, X) in complex64.
        """
        if self.conventions == "authors":
            return published_transfer(self.wall, self.time)[planes]
        return self._rows[planes, :, None] * self._cols[planes, None, :]

    def plane_power(self) -> npt.NDArray[np.float64]:
        """|H|^2 at lateral frequency 0, (F,): of a plane parallel to the wall."""
        if self.conventions == "authors":
            return np.abs(published_transfer(self.wall, self.time)[:, 0, 0]).astype(np.float64) ** 2
        return np.asarray(np.abs(self._rows[:, 0] * self._cols[:, 0]) ** 2, dtype=np.float64)

    def __call__(self, x: Array, conjugate: bool, gain: Gain | None = None) -> Array:
        """x (N, V, H, W) * H, or x * conj(H), times a gain that may depend on |H|^2."""
        return self.by_each(x, conjugate, [gain])[0]

    def by_each(self, x: Array, conjugate: bool, gains: Sequence[Gain | None]) -> list[Array]:
        """The same with one gain after the other: small planes are transformed once for all of them."""
        if tuple(x.shape[1:]) != (self.cells, self.wall.rows, self.wall.cols):
            raise ValueError(
                f"the light cone was built for {self.cells} x {self.wall.rows} x {self.wall.cols} (V, H, W), "
                f"the data are {x.shape[1]} x {x.shape[2]} x {x.shape[3]}. Build it for the wall and time axis of the "
                "data."
            )
        frequencies = self.padded[0] // 2 + 1
        tile = min(self.tile or frequencies, frequencies)
        small = isinstance(x, np.ndarray) and self.conventions == "physical" and tile == frequencies
        if small and small_enough(self.wall.rows, self.wall.cols):
            return filter_even(x, self.padded, self._weights(x, conjugate, gains))
        return [self._by_transforms(x, conjugate, gain, tile) for gain in gains]

    def _by_transforms(self, x: Array, conjugate: bool, gain: Gain | None, tile: int) -> Array:
        """So many frequencies at a time."""
        done = empty(x, tuple(x.shape))
        done[:] = 0
        frequencies = self.padded[0] // 2 + 1
        for first in range(0, frequencies, tile):
            planes = slice(first, min(first + tile, frequencies))
            spectrum = half_spectrum(x, self.padded[0], planes=planes)
            filter_planes_(spectrum, self.padded[1:], self._multiplier(spectrum, conjugate, gain, first))
            add_signal_(done, spectrum, self.padded[0], planes)
        return done

    def _weights(self, x: npt.NDArray[Any], conjugate: bool, gains: Sequence[Gain | None]) -> Weights:
        """H or its conjugate times each gain; frequencies along v lie side by side in memory, for speed."""
        rows, cols = (
            np.ascontiguousarray(part.T.astype(np.result_type(x.dtype, np.complex64)))
            for part in (self._rows, self._cols)
        )
        rows_power, cols_power = (part.real**2 + part.imag**2 for part in (rows, cols))
        if conjugate:
            rows, cols = rows.conj(), cols.conj()

        def weights(planes: slice) -> list[npt.NDArray[Any]]:
            h = (rows[:, None, planes] * cols[:, planes]).transpose(2, 0, 1)
            power = (rows_power[:, None, planes] * cols_power[:, planes]).transpose(2, 0, 1)
            made = [h if gain is None else h * gain(power, planes) for gain in gains]
            return [each if each.ndim == 4 else each[None] for each in made]

        return weights

    def _multiplier(self, spectrum: Array, conjugate: bool, gain: Gain | None, first: int) -> Multiply:
        """What multiplies padded planes of the spectrum, which begins at frequency `first`, by H or its conjugate."""
        if self.conventions == "authors":
            published = beside(spectrum, published_transfer(self.wall, self.time))

            def by_published(block: Array, here: slice) -> None:
                planes = slice(first + here.start, first + here.stop)
                h = published[planes]
                w = h.conj() if conjugate else h
                block *= w if gain is None else w * gain(h.real**2 + h.imag**2, planes)

            return by_published
        rows, cols = beside(spectrum, self._rows), beside(spectrum, self._cols)
        rows_power, cols_power = (part.real**2 + part.imag**2 for part in (rows, cols))
        if conjugate:
            rows, cols = rows.conj(), cols.conj()

        def by_chirps(block: Array, here: slice) -> None:
            planes = slice(first + here.start, first + here.stop)
            w = rows[planes, :, None] * cols[planes, None, :]
            if gain is not None:
                w = w * gain(rows_power[planes, :, None] * cols_power[planes, None, :], planes)
            multiply_even_(block, w)

        return by_chirps
