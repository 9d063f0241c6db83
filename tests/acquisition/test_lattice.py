"""Points of a grid that come as a list are put on that grid again; points that lie on none are not."""

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.wall import WallGrid, grid_around

Floats = npt.NDArray[np.float64]


def listed(wall: WallGrid, share: float = 1.0, seed: int = 0) -> tuple[Floats, Floats]:
    """Points of the wall in any order, this share of them."""
    x_m, y_m = (each.ravel() for each in np.meshgrid(wall.x_m(), wall.y_m()))
    chosen = np.random.default_rng(seed).permutation(len(x_m))[: int(share * len(x_m))]
    return x_m[chosen], y_m[chosen]


@pytest.mark.parametrize("wall", [WallGrid(0.8, 0.8, 32, 32), WallGrid(2.0, 1.5, 48, 64), WallGrid(1.0, 0.7, 21, 50)])
@pytest.mark.parametrize("share", [1.0, 0.9, 0.61, 0.3])
@pytest.mark.parametrize("known", [True, False])
def test_points_of_a_grid_are_on_that_grid(wall: WallGrid, share: float, known: bool) -> None:
    x_m, y_m = listed(wall, share)
    found = grid_around(x_m, y_m, (wall.width_m, wall.height_m) if known else None)
    assert (found.rows, found.cols) == (wall.rows, wall.cols)
    assert (found.width_m, found.height_m) == (pytest.approx(wall.width_m), pytest.approx(wall.height_m))


def test_few_digits_are_enough() -> None:
    x_m, y_m = listed(WallGrid(2.0, 2.0, 64, 64), 0.7)
    found = grid_around(np.round(x_m, 4), y_m.astype(np.float32).astype(np.float64))
    assert (found.rows, found.cols, found.width_m) == (64, 64, pytest.approx(2.0, abs=1e-4))


def test_a_grid_without_its_outer_lines_is_about_the_walls_middle_all_the_same() -> None:
    wall = WallGrid(1.0, 1.0, 40, 40)
    x_m, y_m = listed(wall)
    found = grid_around(x_m[x_m < 0.4], y_m[x_m < 0.4])
    assert found.cols == 40
    assert (found.rows, found.height_m) == (40, pytest.approx(1.0))


def test_points_on_no_grid_have_a_finer_one_of_square_pixels() -> None:
    rng = np.random.default_rng(1)
    x_m, y_m = rng.uniform(-1, 1, (2, 900))
    found = grid_around(x_m, y_m, (2.0, 2.0))
    assert (found.rows, found.cols) == (60, 60)
    wall = WallGrid(2.0, 2.0, 50, 50)
    x_m, y_m = (each + rng.uniform(-0.01, 0.01, 2500) for each in listed(wall))
    assert grid_around(x_m, y_m, (2.0, 2.0)).rows == 100
    assert grid_around(*listed(wall, 0.1), size_m=(2.0, 2.0)).rows == 32


def test_a_grid_that_does_not_fill_the_wall_evenly_is_no_grid_of_that_wall() -> None:
    x_m, y_m = listed(WallGrid(1.0, 1.0, 40, 40))
    assert grid_around(x_m, y_m, (1.01, 1.01)).rows == 80


def test_a_size_from_the_first_point_to_the_last_is_a_wall_one_step_wider() -> None:
    found = grid_around(*listed(WallGrid(1.0, 0.5, 20, 40), 0.7), size_m=(0.975, 0.475))
    assert (found.rows, found.cols) == (20, 40)
    assert (found.width_m, found.height_m) == (pytest.approx(1.0), pytest.approx(0.5))


def test_a_line_and_one_point_lie_on_no_grid() -> None:
    line = np.linspace(-0.5, 0.5, 30)
    assert grid_around(line, np.zeros(30), (1.0, 1.0)).rows == 32
    assert grid_around(np.zeros(1), np.zeros(1), (1.0, 1.0)).rows == 32
