"""Samples at any wall position end up on the grid: where they were, with the weight of their exposure."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import InvalidData
from nlos.recon.gridding import confidence, fill_unmeasured, grid_samples, interpolation

WALL, TIME = WallGrid(1.2, 0.8, 8, 12), TimeAxis(5, 100e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_every_count_and_every_second_arrive_in_the_pixel_they_lie_in(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-0.6, 0.6, count), rng.uniform(-0.4, 0.4, count)
    counts, exposure = rng.poisson(5, (count, 5)).astype(np.float32), rng.uniform(0.1, 1, count)
    gridded = grid_samples(x, y, counts, exposure, WALL, TIME)
    row, col = np.floor((0.4 - y) / 0.1).astype(int), np.floor((x + 0.6) / 0.1).astype(int)
    expected, expected_s = np.zeros((8, 12, 5)), np.zeros((8, 12))
    np.add.at(expected, (row, col), counts)
    np.add.at(expected_s, (row, col), exposure)
    assert np.array_equal(gridded.counts, np.moveaxis(expected, 2, 0))
    assert np.allclose(gridded.exposure_s, expected_s)


def test_a_full_grid_in_any_order_is_itself() -> None:
    rng = np.random.default_rng(1)
    x, y = (a.ravel() for a in np.meshgrid(WALL.x_m(), WALL.y_m()))
    counts = rng.poisson(5, (96, 5)).astype(np.float32)
    order = rng.permutation(96)
    gridded = grid_samples(x[order], y[order], counts[order], np.full(96, 0.5), WALL, TIME)
    assert np.allclose(gridded.counts, counts.T.reshape(5, 8, 12), atol=1e-5)
    assert np.allclose(gridded.exposure_s, 0.5)
    assert np.allclose(confidence(gridded.exposure_s), 1)


def test_samples_in_one_pixel_are_weighted_by_exposure_and_unmeasured_ones_left_out() -> None:
    x, y = np.repeat(WALL.x_m()[[2, 9]], 3), np.repeat(WALL.y_m()[[1, 6]], 3)
    counts = np.array([[10.0], [60.0], [999.0], [4.0], [4.0], [0.0]], dtype=np.float32)
    exposure = np.array([1.0, 3.0, 0.0, 1.0, 1.0, 0.0])
    transient = grid_samples(x, y, counts, exposure, WALL, TimeAxis(1, 1e-10))
    assert transient.counts[0, 1, 2] == pytest.approx(70)
    assert transient.exposure_s[1, 2] == pytest.approx(4)


def test_confidence_falls_with_the_distance_to_the_nearest_sample_and_with_little_exposure() -> None:
    exposure = np.zeros((8, 12))
    assert not confidence(exposure).any()
    exposure[4, [3, 10, 11]] = 2.0, 2.0, 0.5
    trusted = confidence(exposure)
    assert trusted[4, 3] == 1
    assert trusted[4, 11] == pytest.approx(0.25)
    assert trusted[4, 4] == pytest.approx(np.exp(-0.5))
    assert trusted[4, 5] == pytest.approx(np.exp(-2.0))
    assert trusted[4, 5] > trusted[0, 5]


def test_a_scan_along_a_curve_is_not_spread_over_what_it_encloses() -> None:
    row, col = np.indices((40, 40)) - 19.5
    ring = np.abs(np.hypot(row, col) - 18) < 0.8
    filled = fill_unmeasured(torch.ones(1, 1, 2, 40, 40), torch.from_numpy(ring)[None])
    assert np.array_equal(filled[0, 0, 0].numpy() > 0, ring)
    disc = (np.hypot(row, col) < 18) & (np.random.default_rng(4).uniform(size=row.shape) < 0.3)
    filled = fill_unmeasured(torch.ones(1, 1, 2, 40, 40), torch.from_numpy(disc)[None])
    assert torch.allclose(filled, torch.ones(()))


def test_a_hole_in_a_scan_stays_dark() -> None:
    measured = torch.zeros(1, 64, 64, dtype=torch.bool)
    measured[:, ::2, 1::2] = True
    measured[:, 16:36, 40:62] = False
    filled = fill_unmeasured(torch.ones(1, 1, 1, 64, 64), measured)[0, 0, 0]
    assert not filled[22:30, 46:56].any()
    assert torch.allclose(filled[:, :36], torch.ones(()))


def test_beyond_all_triangles_the_nearest_sample_counts() -> None:
    row, col = np.array([2, 2, 5, 6]), np.array([3, 8, 4, 9])
    on_grid = (interpolation(row, col, 8, 12) @ np.array([10.0, 20.0, 30.0, 40.0])).reshape(8, 12)
    assert on_grid[[0, 0, 7, 7], [0, 11, 0, 11]].tolist() == [10.0, 20.0, 30.0, 40.0]
    assert on_grid[row, col].tolist() == pytest.approx([10.0, 20.0, 30.0, 40.0])
    assert on_grid[2, 4] == pytest.approx(12.0)  # on the line between the first two


def test_a_sub_grid_is_interpolated_along_rows_and_columns() -> None:
    """Against the bilinear formula, sample positions kept: rows 1, 3, 5, 7 and columns 1, 4, 7, 10."""
    rows, cols = np.arange(1, 8, 2), np.arange(1, 12, 3)
    values = np.random.default_rng(2).uniform(size=(4, 4))
    row, col = (a.ravel() for a in np.meshgrid(rows, cols, indexing="ij"))
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


def test_a_sample_on_the_very_edge_of_the_wall_is_on_it() -> None:
    x, y = np.array([-0.6, 0.6, -0.6, 0.6]), np.array([0.4, 0.4, -0.4, -0.4])
    gridded = grid_samples(x, y, np.ones((4, 5), np.float32), np.arange(1.0, 5.0), WALL, TIME)
    assert gridded.exposure_s[[0, 0, -1, -1], [0, -1, 0, -1]].tolist() == [1.0, 2.0, 3.0, 4.0]
    for beside in ((0.72, 0.0), (-0.72, 0.0), (0.0, 0.53), (0.0, -0.53)):
        with pytest.raises(InvalidData, match="1 of 1 samples lie beside the wall"):
            grid_samples(*np.array(beside)[:, None], np.ones((1, 5), np.float32), np.ones(1), WALL, TIME)


def test_what_cannot_be_gridded_is_refused() -> None:
    x = np.array([0.0])
    with pytest.raises(InvalidData, match="no sample was measured"):
        grid_samples(x, x, np.ones((1, 5), np.float32), np.zeros(1), WALL, TIME)
    with pytest.raises(InvalidData, match="not finite"):
        grid_samples(x, x, np.full((1, 5), np.nan, np.float32), np.ones(1), WALL, TIME)
    with pytest.raises(
        InvalidData, match=r"1 of 2 samples lie beside the wall of 1.2 x 0.8 m, the first at \(\+0.800 m"
    ):
        grid_samples(np.array([0.0, 0.8]), np.zeros(2), np.ones((2, 5), np.float32), np.ones(2), WALL, TIME)
    with pytest.raises(InvalidData, match=r"1 of 1 samples .* the first at \(\+0.800 m"):  # one that was not measured
        grid_samples(np.array([0.0, 0.8]), np.zeros(2), np.ones((2, 5), np.float32), np.arange(2.0), WALL, TIME)
