"""Samples at any wall position end up on the grid: where they were, with the weight of their exposure."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.transient import TimeAxis
from acquisition.wall import WallGrid
from recon.errors import InvalidData
from recon.gridding import fill_unmeasured, grid_samples, interpolation

WALL, TIME = WallGrid(1.2, 0.8, 8, 12), TimeAxis(5, 100e-12)


def plane_over(x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
    """Counts that are linear in position, (N, T)."""
    return np.asarray((3 + 2 * x_m - y_m)[:, None] * np.arange(1, 6), dtype=np.float32)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 60))
def test_what_is_linear_on_the_wall_is_recovered_inside_the_samples(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-0.6, 0.6, count), rng.uniform(-0.4, 0.4, count)
    gridded = grid_samples(x, y, plane_over(x, y) * 2, np.full(count, 2.0), WALL, TIME)
    rates = gridded.transient.counts / np.maximum(gridded.transient.exposure_s, 1e-9)
    truth = plane_over(*(a.ravel() for a in np.meshgrid(WALL.x_m(), WALL.y_m()))).T.reshape(rates.shape)
    known = gridded.confidence > 0.999  # a sample lies on the grid point or all but
    assert np.allclose(rates[:, known], truth[:, known], atol=0.4)
    low, high = plane_over(x, y).min(), plane_over(x, y).max()
    assert rates.min() >= low - 1e-3
    assert rates.max() <= high + 1e-3  # interpolated, never extrapolated
    assert ((gridded.confidence >= 0) & (gridded.confidence <= 1)).all()


def test_a_full_grid_in_any_order_is_itself() -> None:
    rng = np.random.default_rng(1)
    x, y = (a.ravel() for a in np.meshgrid(WALL.x_m(), WALL.y_m()))
    counts = rng.poisson(5, (96, 5)).astype(np.float32)
    order = rng.permutation(96)
    gridded = grid_samples(x[order], y[order], counts[order], np.full(96, 0.5), WALL, TIME)
    assert np.allclose(gridded.transient.counts, counts.T.reshape(5, 8, 12), atol=1e-5)
    assert np.allclose(gridded.transient.exposure_s, 0.5)
    assert np.allclose(gridded.confidence, 1)


def test_samples_in_one_pixel_are_weighted_by_exposure_and_unmeasured_ones_left_out() -> None:
    x, y = np.repeat(WALL.x_m()[[2, 9]], 3), np.repeat(WALL.y_m()[[1, 6]], 3)
    counts = np.array([[10.0], [60.0], [999.0], [4.0], [4.0], [0.0]], dtype=np.float32)
    exposure = np.array([1.0, 3.0, 0.0, 1.0, 1.0, 0.0])
    transient = grid_samples(x, y, counts, exposure, WALL, TimeAxis(1, 1e-10)).transient
    assert transient.counts[0, 1, 2] == pytest.approx(70)
    assert transient.exposure_s[1, 2] == pytest.approx(4)


def test_confidence_falls_with_the_distance_to_the_nearest_sample() -> None:
    gridded = grid_samples(WALL.x_m()[[3]], WALL.y_m()[[4]], np.ones((1, 5), np.float32), np.ones(1), WALL, TIME)
    assert gridded.confidence[4, 3] == 1
    assert gridded.confidence[4, 4] > gridded.confidence[4, 5] > gridded.confidence[0, 11]
    assert np.allclose(gridded.transient.counts, 1)  # the only one there is


def test_a_sub_grid_is_interpolated_along_rows_and_columns() -> None:
    """Against the bilinear formula, sample positions kept: rows 1, 3, 5, 7 and columns 1, 4, 7, 10."""
    rows, cols = np.arange(1, 8, 2), np.arange(1, 12, 3)
    values = np.random.default_rng(2).uniform(size=(4, 4))
    row, col = (a.ravel().astype(float) for a in np.meshgrid(rows, cols, indexing="ij"))
    on_grid = (interpolation(row, col, 8, 12) @ values.ravel()).reshape(8, 12)
    along = np.stack([np.interp(np.arange(12), cols, line) for line in values])
    expected = np.stack([np.interp(np.arange(8), rows, line) for line in along.T], axis=1)
    assert np.allclose(on_grid, expected)


def test_filling_keeps_what_was_measured_and_is_differentiable() -> None:
    measured = torch.rand(2, 6, 7, generator=torch.Generator().manual_seed(3)) > 0.5
    x = torch.rand(2, 1, 3, 6, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(4)).requires_grad_()
    filled = fill_unmeasured(x, measured)
    kept = measured[:, None, None].expand_as(x)
    assert torch.allclose(filled[kept], x[kept])
    assert torch.autograd.gradcheck(lambda value: fill_unmeasured(value, measured), (x,), fast_mode=True)


def test_what_cannot_be_gridded_is_refused() -> None:
    x = np.array([0.0])
    with pytest.raises(InvalidData, match="no sample was measured"):
        grid_samples(x, x, np.ones((1, 5), np.float32), np.zeros(1), WALL, TIME)
    with pytest.raises(InvalidData, match="not finite"):
        grid_samples(x, x, np.full((1, 5), np.nan, np.float32), np.ones(1), WALL, TIME)
