"""Small planes filtered by products: as SciPy convolves them with the kernel itself, and as padded transforms do."""

import numpy as np
import pytest
import scipy.fft
import scipy.signal

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport.even_planes import filter_even
from nlos.recon.transport.light_cone_filter import LightConeFilter


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(1, 7, 4, 6), (2, 70, 12, 2)])
def test_an_even_kernel_is_convolved_with(shape: tuple[int, ...], kind: type) -> None:
    rng = np.random.default_rng(1)
    samples, cells, rows, cols = shape
    x = rng.normal(size=shape).astype(kind)
    padded = (2 * cells + 2, 2 * rows + 4, 2 * cols)
    kernels, quadrants = [], []
    for _ in range(2):
        corner = rng.normal(size=(cells, rows, cols))  # from no delay and the middle on
        across = np.concatenate([corner[:, :, :0:-1], corner], axis=2)
        kernels.append(np.concatenate([across[:, :0:-1], across], axis=1))
        whole = np.zeros(padded)
        for dy in range(1 - rows, rows):
            for dx in range(1 - cols, cols):
                whole[:cells, dy, dx] = corner[:, abs(dy), abs(dx)]
        transfer = scipy.fft.rfftn(whole, axes=(1, 2, 0))  # half along the first axis
        quadrants.append(transfer[None, :, : rows + 3, : cols + 1])

    made = filter_even(x, padded, lambda planes: [each[:, planes] for each in quadrants])
    for result, kernel in zip(made, kernels, strict=True):
        assert result.dtype == kind
        for n in range(samples):
            full = scipy.signal.convolve(x[n].astype(np.float64), kernel, method="direct")
            wanted = full[:cells, rows - 1 : 2 * rows - 1, cols - 1 : 2 * cols - 1]
            assert np.abs(result[n] - wanted).max() < (1e-5 if kind is np.float32 else 1e-12) * np.abs(wanted).max()


def test_the_light_cone_of_small_walls_is_what_transforms_of_padded_planes_make_it() -> None:
    wall, time = WallGrid(1.0, 0.8, 10, 14), TimeAxis(60, 60e-12, 30e-12)
    light_cone = LightConeFilter(wall, time)
    x = np.random.default_rng(2).normal(size=(2, light_cone.cells, wall.rows, wall.cols))
    noise = np.array([0.1, 3.0])[:, None, None, None]
    gains = [None, lambda power, planes: 1 / (power + noise)]
    for conjugate in (False, True):
        made = light_cone.by_each(x, conjugate, gains)
        for result, gain in zip(made, gains, strict=True):
            wanted = light_cone._by_transforms(x, conjugate, gain, 40)
            assert np.abs(result - wanted).max() < 1e-12 * np.abs(wanted).max()
