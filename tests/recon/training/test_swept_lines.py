"""Lines that a mirror sweeps: what networks learn from is nearer to light rendered along them than that of points."""

import numpy as np

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.detector import pulse, respond, swept
from nlos.recon.training.films import SIDE, WALL, TrainingFilm
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import make_scene, surfels

COARSE, PARTS, LOOKS = 32, 5, 6
AXIS = TimeAxis(128, 128e-12)
POINTS, LINES = WallGrid(2.0, 2.0, COARSE, COARSE), WallGrid(2.0, 2.0, COARSE, COARSE * PARTS)


def test_swept_points_are_means_along_a_pixel() -> None:
    """Held against points rendered five times as close, from so many surfels that their grain does not count."""
    for index in (1, 4):
        scene = make_scene(5, index, WallGrid(2.0, 2.0, 64, 64))
        looks = [surfels(scene, np.random.default_rng(100 * index + k)) for k in range(LOOKS)]
        response = pulse(AXIS, 100, 0.0, 150.0)
        points, lines = (
            respond(np.mean([render(each, wall, AXIS).numpy() for each in looks], axis=0), response)
            for wall in (POINTS, LINES)
        )
        along = lines.reshape(AXIS.bins, COARSE, COARSE, PARTS).mean(axis=-1)
        off, left = (np.sqrt(np.square(each - along).mean()) for each in (points, swept(points)))
        assert left < 0.8 * off, (left, off)
        np.testing.assert_allclose(swept(points).sum(), points.sum(), rtol=1e-5)


def test_films_points_are_means_along_the_way_to_the_next() -> None:
    """A point of a film whose lines are swept is what the same film sees at the five points around it on the mean."""
    film = next(each for k in range(100) if (each := TrainingFilm(77, k, 2))._swept)
    rows, cols = np.meshgrid(np.arange(2, WALL.rows, 9), np.arange(4, WALL.cols - 4, 5), indexing="ij")
    points = (rows * WALL.cols + cols).ravel()
    bodies = film._at(0.05)
    along = film._light(bodies, points)
    film._swept = False
    alone = film._light(bodies, points)
    around = np.mean([film._light(bodies, points + step) for step in range(-SIDE // 2, SIDE // 2 + 1)], axis=0)
    assert np.abs(along - around).sum() < 0.8 * np.abs(alone - around).sum()
