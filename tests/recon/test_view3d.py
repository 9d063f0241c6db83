"""The 3D view: which voxels are shown, where, how bright, and what a thinned volume keeps."""

import base64
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.wall import WallGrid
from nlos.recon import view3d
from nlos.recon.view3d import bright_voxels, solid_points, solid_scene
from nlos.recon.volume import Intervals, Reconstruction, Volume

WALL = WallGrid(1.0, 2.0, 4, 5)
DEPTHS_M = np.array([0.5, 0.75, 1.0, 1.25, 1.5])


def volume_of(*voxels: tuple[int, int, int, float]) -> Volume:
    """(plane, row, column, albedo)."""
    albedo = np.zeros((5, 4, 5), np.float32)
    for plane, row, col, value in voxels:
        albedo[plane, row, col] = value
    return Volume(albedo, DEPTHS_M, WALL)


def made(volume: Volume, seen: np.ndarray) -> Reconstruction:
    nothing = np.zeros((4, 5), np.float32)
    intervals = Intervals(nothing, nothing, nothing, nothing, seen.astype(np.float32))
    return Reconstruction(
        volume.albedo.max(axis=0), nothing + 1.0, WALL, "nano", 0.1, volume=volume, intervals=intervals
    )


def test_bright_voxels_are_ridges_along_depth_where_they_are() -> None:
    """Row 0 is the top, column 0 the left; a slope on either side of a ridge is not shown, nor is what is faint."""
    points_m, albedo = bright_voxels(volume_of((2, 0, 4, 1.0), (1, 0, 4, 0.8), (3, 0, 4, 0.8), (2, 3, 0, 0.01)))
    assert points_m.tolist() == [[pytest.approx(0.4), pytest.approx(0.75), 1.0]]
    assert albedo.tolist() == [pytest.approx(1.0, rel=0.02)]


def test_of_too_many_voxels_the_brightest_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view3d, "MOST_POINTS", 2)
    points_m, _ = bright_voxels(volume_of((2, 0, 0, 0.5), (2, 1, 1, 0.9), (2, 2, 2, 1.0), (2, 3, 3, 0.6)))
    assert sorted(points_m[:, 0].tolist()) == pytest.approx([-0.2, 0.0])


def test_what_the_method_doubts_is_fainter_at_its_own_pixel() -> None:
    seen = np.ones((4, 5))
    seen[0, 4], seen[3, 0] = 0.25, 0.5
    points_m, albedo = solid_points(made(volume_of((2, 0, 4, 1.0), (2, 3, 0, 1.0), (2, 1, 1, 1.0)), seen))
    by_x = {round(x_m, 3): value for x_m, value in zip(points_m[:, 0].tolist(), albedo.tolist(), strict=True)}
    assert by_x == pytest.approx({0.4: 0.25, -0.4: 0.5, -0.2: 1.0}, rel=0.02)


@pytest.mark.parametrize("most", [1000, 40])
def test_a_thinned_volume_keeps_its_brightest_voxels(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(view3d, "MOST_VOXELS", most)
    volume = volume_of((4, 3, 4, 1.0), (0, 0, 0, 0.5))
    scene: dict[str, Any] = solid_scene(made(volume, np.ones((4, 5))))
    shape = scene["volume"]["shape"]
    grey = np.frombuffer(base64.b64decode(scene["volume"]["u1"]), np.uint8).reshape(shape)
    assert np.prod(shape) <= most
    assert (shape == [5, 4, 5]) == (most == 1000)
    assert (grey[-1, -1, -1], grey[0, 0, 0]) == (255, pytest.approx(128, abs=3))
    assert np.count_nonzero(grey) == 2
    assert scene["at"] == [1.0, 0.0, 1.0]
    assert scene["depths"] == [0.5, 1.5]
