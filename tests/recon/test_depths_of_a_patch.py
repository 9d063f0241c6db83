"""How deep a small patch is said to lie, by light that is summed here, point by point."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.response import gaussian
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.depth_range import within_depths
from nlos.recon.reconstruct import reconstruct

WALL, TIME = WallGrid(2.0, 2.0, 32, 32), TimeAxis(256, 64e-12)


@lru_cache
def light(*depths_m: float) -> npt.NDArray[np.float64]:
    """(T, H, W) of upright patches of 0.3 m, side by side in x, whose points return 1 / distance^4."""
    wall_x_m, wall_y_m = np.meshgrid(WALL.x_m(), WALL.y_m())
    across_m = (np.arange(30) - 14.5) * 0.01
    counts = np.zeros((TIME.bins, WALL.rows * WALL.cols))
    for k, depth_m in enumerate(depths_m):
        middle_m = 0.8 * (k - (len(depths_m) - 1) / 2)
        for x_m in across_m + middle_m:
            squared = (wall_x_m - x_m) ** 2 + (wall_y_m - across_m[:, None, None]) ** 2 + depth_m**2
            place = 2 * np.sqrt(squared) / SPEED_OF_LIGHT_M_PER_S / TIME.bin_width_s - 0.5
            early = np.floor(place).astype(int)
            at = np.broadcast_to(np.arange(counts.shape[1]).reshape(wall_x_m.shape), early.shape)
            np.add.at(counts, (early, at), (early + 1 - place) / squared**2)
            np.add.at(counts, (early + 1, at), (place - early) / squared**2)
    return counts.reshape(TIME.bins, WALL.rows, WALL.cols) * (1e6 / counts.sum())


def transient(*depths_m: float) -> Transient:
    """Counts of an instant response."""
    return Transient(light(*depths_m), np.ones((WALL.rows, WALL.cols)), WALL, TIME)


@pytest.mark.parametrize(("method", "within_m"), [("lct", 8e-3), ("fk", 4e-3), ("phasor", 4e-3)])  # a bin is 9.6 mm
@pytest.mark.parametrize("depth_m", [0.4, 0.6, 1.0, 1.4])
def test_a_patch_is_where_it_is(method: str, within_m: float, depth_m: float) -> None:
    made = reconstruct(transient(depth_m), method)
    assert np.nanmedian(made.depth_m[14:18, 14:18]) == pytest.approx(depth_m, abs=within_m)


@pytest.mark.parametrize("method", ["lct", "gram", "gradient_descent"])
def test_a_patch_near_the_wall_where_a_cell_of_the_cone_is_four_bins_deep_is_where_it_is(method: str) -> None:
    """To a third of a cell; the first of its bins, 22 mm nearer, was said."""
    made = reconstruct(transient(0.25), method, explain=False)
    assert np.nanmedian(made.depth_m[14:18, 14:18]) == pytest.approx(0.25, abs=12e-3)


def test_a_plane_that_holds_a_trace_of_the_next_cell_belongs_to_its_own() -> None:
    """0.2 % of it: the first of two planes of the highest cell was said, 13 mm nearer."""
    wall, time = WallGrid(64 / 31, 64 / 31, 32, 32), TimeAxis(256, 49.19e-12)
    across_m = (np.arange(25) - 12) * 0.0125
    x_m, y_m = (each.ravel() for each in np.meshgrid(across_m, across_m))
    counts = np.zeros((time.bins, wall.rows, wall.cols))
    for row, col in np.ndindex(wall.rows, wall.cols):
        r_m = np.sqrt((wall.x_m()[col] - x_m) ** 2 + (wall.y_m()[row] - y_m) ** 2 + 0.5**2)
        at = (2 * r_m / SPEED_OF_LIGHT_M_PER_S / time.bin_width_s).astype(int)
        counts[:, row, col] = np.bincount(at, r_m**-4.0, time.bins)
    made = reconstruct(Transient(counts * (200 / counts.max()), np.ones((32, 32)), wall, time), "lct", explain=False)
    assert np.nanmedian(made.depth_m[14:18, 14:18]) == pytest.approx(0.5, abs=5e-3)


@pytest.mark.parametrize("peak", [None, 20])
@pytest.mark.parametrize("fwhm_ps", [100, 200, 500])
@pytest.mark.parametrize("depth_m", [0.4, 0.7, 1.0, 1.4])
def test_a_patch_is_where_it_is_where_a_slow_response_is_told(depth_m: float, fwhm_ps: int, peak: int | None) -> None:
    per_bin = TIME.bin_width_s * 1e12 / fwhm_ps
    curve = np.exp2(-4 * (np.arange(-40, 41) * per_bin) ** 2)
    slow = np.apply_along_axis(np.convolve, 0, light(depth_m), curve / curve.sum(), "same")
    if peak is not None:
        slow = np.random.default_rng(0).poisson(slow * (peak / slow.max())).astype(np.float64)
    told = gaussian(fwhm_ps * 1e-12, "known")
    made = reconstruct(Transient(slow, np.ones((WALL.rows, WALL.cols)), WALL, TIME, told), "fk", explain=False)
    within_m = 5e-3 if peak is None else 8e-3
    assert np.nanmedian(made.depth_m[14:18, 14:18]) == pytest.approx(depth_m, abs=within_m)


def test_what_a_range_leaves_keeps_the_methods_own_depth() -> None:
    whole = reconstruct(transient(0.6, 1.2), "phasor")
    far = within_depths(whole, 0.9, 1.6)
    right = np.s_[14:18, 21:24]  # x = 0.4 m
    assert np.array_equal(far.depth_m[right], whole.depth_m[right])
    assert np.isnan(far.depth_m[14:18, 8:11]).all()
