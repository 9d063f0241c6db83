"""A film's picture made on half the grid lies where the one on the whole grid would."""

from dataclasses import replace

import numpy as np
import pytest

from nlos.acquisition.planning.frames import bayer
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.over_time.half_grid import on_half_grid
from nlos.recon.over_time.moments import Moments
from nlos.recon.volume import Reconstruction

WALL, TIME = WallGrid(2.0, 1.6, 40, 64), TimeAxis(8, 32e-12)


def _part(number: int, wall: WallGrid = WALL) -> Moments:
    row, col = np.divmod(np.arange(wall.rows * wall.cols), wall.cols)
    chosen = np.flatnonzero(bayer(4)[row % 4, col % 4] == number)
    x_m, y_m = wall.x_m()[col[chosen]], wall.y_m()[row[chosen]]
    counts = np.random.default_rng(number).poisson(2.0, (len(chosen), TIME.bins)).astype(np.float32)
    return Moments(x_m, y_m, counts, np.full(len(x_m), 1e-3), np.zeros(len(x_m)), wall, TIME)


@pytest.mark.parametrize("number", range(16))
def test_the_picture_lies_where_the_points_of_every_part_were(number: int) -> None:
    points = _part(number)
    half = on_half_grid([points], [1.0])
    small = half.light.wall
    assert (small.rows, small.cols) == (20, 32)
    assert half.light.counts.sum() == points.counts.sum()
    assert np.count_nonzero(half.light.exposure_s) == len(points.x_m)
    middles_x, middles_y = small.x_m() + half.shift_m[0], small.y_m() + half.shift_m[1]
    assert np.abs(points.x_m[:, None] - middles_x).min(axis=1).max() < 1e-9
    assert np.abs(points.y_m[:, None] - middles_y).min(axis=1).max() < 1e-9

    across, down = np.meshgrid(middles_x, middles_y)
    blob = np.exp(-0.5 * ((across - 0.31) ** 2 + (down + 0.17) ** 2) / 0.15**2).astype(np.float32)
    depth_m = np.where(blob > 0.05, 1.0 + 0.1 * across, np.nan).astype(np.float32)
    large = half.enlarged(Reconstruction(blob, depth_m, small, "lct", 0.0))
    assert large.wall == WALL
    fine_x, fine_y = np.meshgrid(WALL.x_m(), WALL.y_m())
    weight = large.albedo / large.albedo.sum()
    assert ((weight * fine_x).sum(), (weight * fine_y).sum()) == pytest.approx((0.31, -0.17), abs=2e-3)
    seen = np.isfinite(large.depth_m)
    assert np.abs(large.depth_m - 1.0 - 0.1 * fine_x)[seen].max() < 0.004


def test_coarse_and_odd_grids_are_left_as_they_are() -> None:
    for wall in (WallGrid(1.0, 1.0, 32, 32), WallGrid(1.0, 1.0, 36, 35)):
        half = on_half_grid([replace(_part(0, wall), wall=wall)], [1.0])
        assert half.light.wall == wall
        made = Reconstruction(np.ones((wall.rows, wall.cols), np.float32), np.ones((1, 1)), wall, "lct", 0.0)
        assert half.enlarged(made) is made
