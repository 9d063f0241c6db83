"""Trails of a film under way: places steadied by those before them, numbers that stay with their objects."""

import numpy as np
import pytest

from nlos.acquisition.wall import WallGrid
from nlos.live.trails import Trails
from nlos.recon.volume import Reconstruction

WALL = WallGrid(2.0, 2.0, 64, 64)
TIME_S = np.arange(16) * 0.1


def picture(*centres_m: tuple[float, float, float]) -> Reconstruction:
    """Soft spots at x, y and depth."""
    x_m, y_m = np.meshgrid(WALL.x_m(), WALL.y_m())
    albedo, depth = np.zeros((64, 64), np.float32), np.full((64, 64), np.nan, np.float32)
    for x, y, z in centres_m:
        spot = np.exp(-((x_m - x) ** 2 + (y_m - y) ** 2) / (2 * 0.06**2)).astype(np.float32)
        depth[spot > 0.1] = z
        albedo = np.maximum(albedo, spot)
    return Reconstruction(albedo, depth, WALL, "nano", 0.0)


def test_the_newest_place_is_nearer_to_where_the_object_is_than_its_picture() -> None:
    way, off_alone_m, off_m = np.array([0.5, -0.2, 0.1]), [], []
    for seed in range(6):
        trails, rng = Trails(), np.random.default_rng(seed)
        for time_s in TIME_S:
            true = np.array([-0.4, 0.1, 0.8]) + way * time_s
            seen = true + rng.normal(size=3) * 0.015
            trails.add(picture(tuple(seen)), float(time_s))
            if time_s > 0.7:
                (told,) = trails.told
                off_m.append(np.linalg.norm([told["x_m"][-1], told["y_m"][-1], told["z_m"]] - true))
                off_alone_m.append(np.linalg.norm(seen - true))
        assert len(told["x_m"]) == len(TIME_S)
        assert told["velocity_m_per_s"] == pytest.approx(way.tolist(), abs=0.1)
    assert np.median(off_m) < 0.75 * np.median(off_alone_m)


def test_an_object_keeps_its_number_when_another_is_gone() -> None:
    trails = Trails()
    numbers = []
    for k, time_s in enumerate(TIME_S):
        both = [(-0.4, 0.3, 0.7), (0.4, -0.3, 0.9)]
        trails.add(picture(*(both if k < 8 else both[1:])), float(time_s))
        numbers.append({told["object"]: told["x_m"][-1] > 0 for told in trails.told})
    assert numbers[7].keys() == {0, 1}
    (stays,) = (number for number, right in numbers[7].items() if right)
    assert numbers[-1] == {stays: True}
