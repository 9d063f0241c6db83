"""Scenes: the same from the same seed, physical, and of two families that share no kind."""

import numpy as np
import pytest

from nlos.acquisition.wall import WallGrid
from nlos.recon.training.scenes import OVERSAMPLING, front_view, kind_names, make_scene, surfels

GRID = WallGrid(2.0, 2.0, 32, 32)
EVERY_KIND = [(held_out, kind) for held_out in (False, True) for kind in kind_names(held_out)]


@pytest.mark.parametrize(("held_out", "kind"), EVERY_KIND)
def test_every_kind_draws_a_surface_before_the_wall(held_out: bool, kind: str) -> None:
    for index in range(4):
        scene = make_scene(3, index, GRID, held_out=held_out, kinds=(kind,))
        view = front_view(scene, GRID)
        present = scene.coverage > 0
        assert present.mean() > 0.004
        assert np.isfinite(scene.depth_m[present]).all()
        assert scene.depth_m[present].min() > 0.2
        assert scene.depth_m[present].max() < 2.5
        np.testing.assert_allclose(np.linalg.norm(scene.normal[:, present], axis=0), 1, atol=1e-4)
        assert (scene.normal[2, present] <= 0).all()
        assert ((scene.albedo[present] > 0) & (scene.albedo[present] <= 1)).all()
        assert (view.intensity <= view.albedo + 1e-6).all()
        assert (view.depth_m[view.mask] > 0.2).all()
        assert (view.depth_m[~view.mask] == 0).all()


def test_kinds_held_out_match_kinds_trained_on_in_number_and_share_none() -> None:
    assert len(kind_names(True)) == len(kind_names(False))
    assert not set(kind_names(True)) & set(kind_names(False))


def test_a_scene_is_its_seed_and_index() -> None:
    again = make_scene(5, 17, GRID)
    np.testing.assert_array_equal(make_scene(5, 17, GRID).depth_m, again.depth_m)
    assert not np.array_equal(make_scene(5, 18, GRID).depth_m, again.depth_m)
    assert not np.array_equal(make_scene(6, 17, GRID).depth_m, again.depth_m)


def test_truth_keeps_the_light_whatever_the_grid() -> None:
    scene = make_scene(1, 2, GRID)
    fine = front_view(scene, WallGrid(2.0, 2.0, 32 * OVERSAMPLING, 32 * OVERSAMPLING))
    coarse = front_view(scene, WallGrid(2.0, 2.0, 16, 16))
    assert coarse.intensity.mean() == pytest.approx(fine.intensity.mean(), rel=1e-5)
    assert coarse.coverage.mean() == pytest.approx(scene.coverage.mean(), rel=1e-5)
    with pytest.raises(ValueError, match="does not divide"):
        front_view(scene, WallGrid(2.0, 2.0, 24, 24))


def test_surfels_carry_the_area_of_the_surface() -> None:
    scene = make_scene(1, 4, GRID, kinds=("charts",))
    pieces = surfels(scene, np.random.default_rng(0))
    cell = (2.0 / 64) ** 2
    seen = (pieces.weight_m2 * -pieces.normal[:, 2]).sum()
    facing = -scene.normal[2] > 0.15
    assert seen == pytest.approx((scene.albedo * scene.coverage * facing).sum() * cell, rel=0.05)


def test_an_unknown_kind_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="unicorns"):
        make_scene(1, 0, GRID, kinds=("unicorns",))
