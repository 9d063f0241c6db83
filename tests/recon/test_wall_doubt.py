"""Where doubt asks for points: as light of doubtful pixels falls, and before them for second looks."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import spearmanr

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.points_and_photons import ERROR, PHOTONS, POINTS, expected_error
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import Surfels
from nlos.recon.volume import Intervals, Reconstruction
from nlos.recon.wall_doubt import wanted_on_wall

WALL = WallGrid(2.0, 1.0, 16, 32)


def picture(doubtful: tuple[int, int] | None, depth_m: float = 0.6, wall: WallGrid = WALL) -> Reconstruction:
    """Sure of everything but one pixel."""
    albedo = np.full((wall.rows, wall.cols), 0.5, dtype=np.float32)
    width, depth = np.zeros_like(albedo), np.full_like(albedo, depth_m)
    if doubtful is not None:
        width[doubtful] = 0.4
    known = Intervals(albedo - width / 2, albedo + width / 2, depth, depth, np.ones_like(albedo))
    return Reconstruction(albedo, depth, wall, "nano", 0.0, {}, intervals=known)


def light_of(pixel: tuple[int, int], depth_m: float) -> np.ndarray:
    """(H, W): what a small piece of surface at that pixel sends to every point of the wall."""
    place = np.array([[WALL.x_m()[pixel[1]], WALL.y_m()[pixel[0]], depth_m]], dtype=np.float32)
    surfels = Surfels(place, np.array([[0, 0, -1]], dtype=np.float32), np.ones(1, dtype=np.float32))
    return render(surfels, WALL, TimeAxis(512, 64e-12)).numpy().sum(axis=0)


@pytest.mark.parametrize("pixel", [(3, 5), (12, 30), (8, 16)])
def test_new_points_are_wanted_where_light_of_the_doubtful_pixel_falls(pixel: tuple[int, int]) -> None:
    wanted = wanted_on_wall(picture(pixel))
    assert wanted is not None
    assert spearmanr(wanted.new.ravel(), light_of(pixel, 0.6).ravel()).statistic > 0.99
    assert wanted.new.mean() == pytest.approx(1, abs=1e-5)
    assert wanted.new.min() > 0


def test_second_looks_are_wanted_before_the_doubtful_pixel_and_nowhere_never() -> None:
    wanted = wanted_on_wall(picture((3, 5)))
    assert wanted is not None
    assert np.unravel_index(wanted.again.argmax(), wanted.again.shape) == (3, 5)
    assert wanted.again.min() > 0


def test_a_finer_picture_wants_the_same_as_its_average() -> None:
    fine = wanted_on_wall(picture((40, 40), wall=WallGrid(1.0, 1.0, 64, 64)))
    coarse = wanted_on_wall(picture((20, 20), wall=WallGrid(1.0, 1.0, 32, 32)))
    assert fine is not None
    assert coarse is not None
    assert np.allclose(fine.new.reshape(32, 2, 32, 2).mean(axis=(1, 3)), coarse.new, rtol=0.05)


def test_without_doubt_or_without_intervals_nothing_is_wanted() -> None:
    assert wanted_on_wall(picture(None)) is None
    blind = picture((3, 5), depth_m=np.nan)
    assert wanted_on_wall(blind) is None
    assert wanted_on_wall(Reconstruction(blind.albedo, blind.depth_m, WALL, "lct", 0.0, {})) is None


def test_expected_errors_are_those_measured_and_more_light_or_points_are_never_worse() -> None:
    for points, row in zip(POINTS, ERROR, strict=True):
        for photons, error in zip(PHOTONS, row, strict=True):
            assert expected_error(points, photons) == pytest.approx(error, rel=1e-6)
    finer = np.geomspace(PHOTONS[0] / 10, PHOTONS[-1] * 10, 40)
    for points in (1, 30, 300, 1000, 5000):
        errors = [expected_error(points, photons) for photons in finer]
        assert all(b <= a + 1e-9 for a, b in pairwise(errors))
    assert expected_error(4096, 10.0) == pytest.approx(expected_error(1024, 40.0))
    assert expected_error(100, 0.0) == 1.0
