"""What counts as seen: one rule for every picture, view and export; noise that stands alone is no surface."""

from pathlib import Path
from typing import cast

import numpy as np
import pytest

from nlos.acquisition.wall import WallGrid
from nlos.live.describe import described
from nlos.napari_layers import layers
from nlos.recon.contours import contours
from nlos.recon.depth_range import within_depths
from nlos.recon.live import LivePicture
from nlos.recon.results import write_results
from nlos.recon.seen import FAINT, FULL, depth_limits, depth_opacity, depth_span, visible_depth
from nlos.recon.surface import front_surface
from nlos.recon.view3d import _volume, solid_scene
from nlos.recon.volume import Reconstruction, Volume

WALL = WallGrid(1.0, 1.0, 64, 64)
X_M, Y_M = np.meshgrid(WALL.x_m(), WALL.y_m())


def made(depth_m: np.ndarray, albedo: np.ndarray) -> Reconstruction:
    return Reconstruction(albedo.astype(np.float32), depth_m.astype(np.float32), WALL, "lct", 0.5)


def bowl(seed: int = 0, speckle: float = 0.0, noise_m: float = 0.0) -> Reconstruction:
    """A bowl 20 cm deep and 80 cm wide, and around it faint speckle at any depth, at a part of the pixels."""
    draw = np.random.default_rng(seed)
    inside = np.hypot(X_M, Y_M) < 0.4
    depth_m = np.where(inside, 0.8 + 1.25 * (X_M**2 + Y_M**2), np.nan) + noise_m * draw.normal(size=X_M.shape)
    lit = ~inside & (draw.random(X_M.shape) < speckle)
    depth_m[lit] = draw.uniform(0.1, 3.0, int(lit.sum()))
    return made(depth_m, np.where(inside, 1.0, np.where(lit, 0.2, 0.0)))


def test_speckle_is_not_seen_and_surfaces_are() -> None:
    plain, speckled = visible_depth(bowl()), visible_depth(bowl(speckle=0.1))
    inside = np.isfinite(plain)
    assert inside.sum() == (np.hypot(X_M, Y_M) < 0.4).sum()
    assert np.array_equal(plain[inside], speckled[inside])
    assert np.isfinite(speckled[~inside]).mean() < 0.001
    span = depth_span([bowl(speckle=0.1)])
    assert span is not None
    assert span == pytest.approx(depth_span([bowl()]), abs=0.005)


def test_a_bright_point_alone_and_a_faint_patch_are_seen() -> None:
    albedo, depth_m = np.zeros((64, 64)), np.full((64, 64), np.nan)
    albedo[2:4, 2:4] = albedo[10:12, 10:12] = 1.0  # the brightest are surfaces of any size
    albedo[30, 30], albedo[40, 40] = FULL + 0.01, FULL - 0.01
    albedo[50:52, 50:52] = FAINT + 0.01
    depth_m[albedo > 0] = 0.7
    seen = np.isfinite(visible_depth(made(depth_m, albedo)))
    assert seen[30, 30]
    assert not seen[40, 40]
    assert seen[50:52, 50:52].all()


def test_every_view_shows_the_same_pixels(tmp_path: Path) -> None:
    result = bowl(speckle=0.2)
    seen = np.isfinite(visible_depth(result))
    assert np.array_equal(depth_opacity(result) > 0, seen)
    surface = front_surface(result)  # PLY, OBJ, GLB and the surface in 3D
    assert np.allclose(np.sort(surface.points_m[:, 2]), np.sort(result.depth_m[seen]))
    assert solid_scene(result)["quads"] is not None
    page = described(LivePicture(result, 1, 1.0, 0.1, np.ones((64, 64), dtype=np.float32)))
    assert page["points"]["shape"][0] == seen.sum()
    write_results(tmp_path / "out", result)
    depth = next(data for data, about, _ in layers(str(tmp_path / "out/reconstruction.h5")) if "depth" in about["name"])
    assert np.array_equal(np.isfinite(depth), seen)


def test_lines_of_equal_depth_lie_where_the_depth_is() -> None:
    result = bowl(noise_m=0.0005)
    lines = contours(result, depth_limits([result]))
    assert lines is not None
    assert lines.step_m == 0.02
    assert np.allclose(lines.levels_m / lines.step_m, np.round(lines.levels_m / lines.step_m))
    drawn = np.isfinite(lines.depth_m)
    assert drawn.mean() > 0.4
    assert np.abs(lines.depth_m - 0.8 - 1.25 * (X_M**2 + Y_M**2))[drawn].max() < 0.02


def test_no_lines_on_what_is_flat_or_torn_by_noise_or_across_a_step() -> None:
    flat = made(np.where(np.abs(X_M) < 0.4, 0.8, np.nan), np.ones((64, 64)))
    assert contours(flat, depth_limits([flat])) is None
    torn = bowl(noise_m=0.05)
    assert contours(torn, depth_limits([torn])) is None
    step = made(np.where(X_M < 0, 0.6 + 0.6 * Y_M, 0.9 + 0.6 * Y_M), np.ones((64, 64)))
    lines = contours(step, depth_limits([step]))
    assert lines is not None
    assert np.isnan(lines.depth_m[:, 31:33]).all()


@pytest.mark.parametrize("along", ["x", "y"])
def test_a_single_line_of_points_has_its_pictures_without_lines(tmp_path: Path, along: str) -> None:
    """Between whose points matplotlib draws none; everything else would have drawn them."""
    wall = WallGrid(1.0, 0.01, 1, 100) if along == "x" else WallGrid(0.01, 1.0, 100, 1)
    depth_m = (0.6 + 0.0023 * np.arange(100, dtype=np.float32)).reshape(wall.rows, wall.cols)
    line = Reconstruction(np.ones_like(depth_m), depth_m, wall, "lct", 0.1)
    assert contours(line, depth_limits([line])) is None
    write_results(tmp_path / "out", line)
    assert (tmp_path / "out" / "depth.png").is_file()


@pytest.mark.parametrize(("row", "col", "plane"), [(0, 3, 2), (7, 0, 9)])
def test_the_brightest_voxel_lies_where_the_volume_says_up_being_1(row: int, col: int, plane: int) -> None:
    albedo = np.zeros((10, 8, 8), np.float32)
    albedo[plane, row, col] = 1.0
    volume = Volume(albedo, np.linspace(0.5, 1.5, 10), WallGrid(1.0, 1.0, 8, 8))
    across, up, deep = cast(list[float], _volume(volume)["at"])
    assert (across, up, deep) == pytest.approx((col / 7, 1 - row / 7, plane / 9))


@pytest.mark.parametrize("keeps_volume", [True, False])
def test_a_range_of_depths_holds_its_ends(keeps_volume: bool) -> None:
    planes = np.array([0.5, 1.0, 1.5])
    albedo = np.zeros((3, 8, 8), np.float32)
    albedo[0, 0, 0] = albedo[1, 1, 1] = albedo[2, 2, 2] = 1.0
    volume = Volume(albedo, planes, WallGrid(1.0, 1.0, 8, 8)) if keeps_volume else None
    depth = np.full((8, 8), np.nan, np.float32)
    depth[0, 0], depth[1, 1], depth[2, 2] = planes
    whole = Reconstruction(albedo.max(axis=0), depth, WallGrid(1.0, 1.0, 8, 8), "lct", 0.5, volume=volume)
    kept = within_depths(whole, 0.5, 1.0)
    assert [kept.albedo[k, k] for k in range(3)] == [1, 1, 0]
    assert [kept.depth_m[k, k] for k in range(2)] == [0.5, 1.0]
