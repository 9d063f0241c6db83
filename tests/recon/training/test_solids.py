"""Bodies with sides and rears: light from beside the front view, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.dataset import samples_of_scene
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.held_out_kinds import HELD_OUT
from nlos.recon.training.kinds import BY_NAME, TRAINED
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import Scene, Surfels, front_view, make_scene, surfels
from nlos.recon.training.shapes import (
    STEEPEST,
    Canvas,
    Turned,
    blank_canvas,
    box,
    ellipsoid,
    panel,
    rotation_matrix,
    turned,
)
from nlos.recon.training.solids import hidden_pieces

GRID = WallGrid(2.0, 2.0, 32, 32)
UPRIGHT = np.eye(3)


def pieces(canvas: Canvas, texture: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return hidden_pieces(canvas, texture, 0.25)


def test_the_treads_of_a_stair_send_light_upwards() -> None:
    canvas = blank_canvas(128, 128)
    box(canvas, (0.0, -0.5, 0.9), (0.4, 0.2, 0.2), UPRIGHT, 0.5)
    place, normal, weight = pieces(canvas)
    tread = normal[:, 1] > 0.99
    assert np.allclose(place[tread, 1], -0.3, atol=1e-6)
    assert weight[tread].sum() == pytest.approx(0.5 * 0.8 * 0.4, rel=1e-5), "albedo times the tread's area"
    assert not (normal[:, 2] < -0.5).any(), "the front is in the front view"
    assert not (normal[:, 2] > 0.5).any(), "no point of the wall sees the back"


def test_a_face_that_no_point_of_the_wall_sees_is_left_out() -> None:
    canvas = blank_canvas(64, 64)
    box(canvas, (0.0, 0.75, 0.9), (0.2, 0.3, 0.2), UPRIGHT, 0.5)  # its top is above the wall
    assert not (pieces(canvas)[1][:, 1] > 0.99).any()


def test_the_rear_of_a_ball_is_a_ball() -> None:
    canvas = blank_canvas(128, 128)
    ellipsoid(canvas, (0.1, 0.0, 0.9), (0.4, 0.4, 0.4), UPRIGHT, 1.0)
    place, normal, _ = pieces(canvas)
    assert len(place) > 50
    out = (place - [0.1, 0.0, 0.9]) / 0.4
    assert np.allclose(np.linalg.norm(out, axis=1), 1, atol=1e-4)
    assert np.allclose(out, normal, atol=1e-3)
    assert (normal[:, 2] > -STEEPEST).all(), "rear and outline"


def test_nothing_within_another_body_sends_light() -> None:
    canvas = blank_canvas(128, 128)
    ellipsoid(canvas, (0.0, 0.0, 0.9), (0.5, 0.5, 0.5), UPRIGHT, 1.0)
    alone = len(pieces(canvas)[2])
    box(canvas, (0.0, 0.0, 0.9), (0.1, 0.1, 0.1), UPRIGHT, 1.0)
    assert len(pieces(canvas)[2]) == alone


def test_a_sheet_behind_another_sends_the_light_that_the_front_view_lacks() -> None:
    canvas = blank_canvas(64, 64)
    whole = np.ones((64, 64), np.float32)
    panel(canvas, whole * (np.abs(canvas.x)[None] < 0.3), 0.6, (0.0, 0.0), 0.5)
    panel(canvas, whole, 1.1, (0.0, 0.0), 0.8)
    place, _, weight = pieces(canvas)
    assert np.allclose(place[:, 2], 1.1)
    assert np.abs(place[:, 0]).max() < 0.3
    covered = np.count_nonzero(np.abs(canvas.x) < 0.3) * 64 * canvas.pitch**2
    assert weight.sum() == pytest.approx(0.8 * covered, rel=0.05)


def light_of(position: np.ndarray, normal: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Light by wall point and 0.3 ns, without anything in its way."""
    parts = (np.ascontiguousarray(part, dtype=np.float32) for part in (position, normal, weight))
    return render(Surfels(*parts), WallGrid(2.0, 2.0, 8, 8), TimeAxis(64, 300e-12)).numpy()


def shown_and_hidden(canvas: Canvas) -> tuple[np.ndarray, np.ndarray]:
    """Light of the front view alone, and of all."""
    present = np.isfinite(canvas.depth)
    scene = Scene("one", WallGrid(2.0, 2.0, *present.shape), canvas.depth, canvas.normal * present,
                  canvas.albedo * present, canvas.coverage * present)  # fmt: skip
    scenes = (scene, replace(scene, hidden=Surfels(*pieces(canvas))))
    shown, solid = (surfels(each, np.random.default_rng(0)) for each in scenes)
    return tuple(light_of(each.position_m, each.normal, each.weight_m2) for each in (shown, solid))  # type: ignore[return-value]


def test_a_ball_sends_the_light_of_a_ball() -> None:
    """Held against points laid evenly over the whole sphere, which know nothing of front views."""
    canvas = blank_canvas(256, 256)
    ellipsoid(canvas, (0.0, 0.0, 0.9), (0.4, 0.4, 0.4), UPRIGHT, 1.0)
    count = 60_000
    height = 1 - (2 * np.arange(count) + 1) / count
    around = np.arange(count) * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    out = np.stack((ring * np.cos(around), ring * np.sin(around), height), axis=1)
    truth = light_of(0.4 * out + [0, 0, 0.9], out, np.full(count, 4 * np.pi * 0.4**2 / count))
    shown, solid = shown_and_hidden(canvas)
    error = np.abs(solid - truth).sum(axis=0) / truth.sum(axis=0)
    missing = np.abs(shown - truth).sum(axis=0) / truth.sum(axis=0)
    assert error.max() < 0.05, error
    assert missing[0, 0] > 2 * error[0, 0], "a corner of the wall sees what the front view does not"


def test_a_box_sends_the_light_of_a_box() -> None:
    """Held against points laid evenly over its six faces."""
    canvas, turn = blank_canvas(256, 256), rotation_matrix(0.3, -0.2, 0.1)
    half = np.array([0.3, 0.35, 0.25])
    box(canvas, (0.1, -0.1, 0.9), (0.3, 0.35, 0.25), turn, 1.0)
    rng, faces = np.random.default_rng(4), []
    for axis in range(3):
        area = 4 * np.prod(np.delete(half, axis))
        for outward in (-1, 1):
            at = rng.uniform(-half, half, (20_000, 3))
            at[:, axis] = outward * half[axis]
            normal = np.tile(outward * turn[:, axis], (len(at), 1))
            faces.append((at @ turn.T + [0.1, -0.1, 0.9], normal, np.full(len(at), area / len(at))))
    truth = light_of(*(np.concatenate(part) for part in zip(*faces, strict=True)))
    shown, solid = shown_and_hidden(canvas)
    error = np.abs(solid - truth).sum(axis=0) / truth.sum(axis=0)
    missing = np.abs(shown - truth).sum(axis=0) / truth.sum(axis=0)
    assert error.max() < 0.08, error
    assert missing.max() > 2 * error.max()


@pytest.mark.parametrize("kind", sorted(TRAINED | BY_NAME | HELD_OUT))
def test_solid_scenes_show_the_same_and_send_more(kind: str) -> None:
    for number in range(4):  # textures among them, whose blotches must not take light away
        plain, solid = (
            make_scene(31, number, GRID, held_out=kind in HELD_OUT, kinds=(kind,), solid=s) for s in (False, True)
        )
        for name in ("intensity", "depth_m", "coverage"):
            assert np.array_equal(getattr(front_view(plain, GRID), name), getattr(front_view(solid, GRID), name))
        shown, all_of_it = (surfels(scene, np.random.default_rng(1)) for scene in (plain, solid))
        count = shown.weight_m2.size
        assert np.array_equal(all_of_it.position_m[:count], shown.position_m)
        assert np.isfinite(all_of_it.position_m).all()
        assert (all_of_it.weight_m2 >= 0).all()
        light = [render(each, GRID, TimeAxis(128, 128e-12)) for each in (shown, all_of_it)]
        assert (light[1] - light[0]).min() >= -1e-4 * light[0].max()
        assert light[1].isfinite().all()


def test_light_through_bodies_is_refused() -> None:
    with pytest.raises(ValidationError, match="solid: true needs shadows: true"):
        DatasetSettings(solid=True)


def test_a_vase_has_the_rear_of_a_vase() -> None:
    """A cylinder that leans: its rear lies where the formula of its axis says, and its normals point away from it."""
    canvas = blank_canvas(128, 128)
    turned(canvas, (0.0, 0.0, 0.9), Turned(np.full(20, 0.3), 1.2, 0.0, 0.2), 1.0)
    place, normal, _ = pieces(canvas)
    assert len(place) > 50
    axis = 0.9 + 0.2 * place[:, 1]
    assert np.allclose(np.hypot(place[:, 0], place[:, 2] - axis), 0.3, atol=1e-5)
    slope = np.array([0.0, 1.0, 0.2])
    inner = np.abs(place[:, 1]) < 0.5
    assert np.abs(normal[inner] @ slope).max() < 0.02, "the surface runs along the axis"
    assert (normal[:, 2] > -STEEPEST).all()


@pytest.mark.parametrize("besides", ["", "retroreflective", "second_bounce"])
def test_a_setting_asks_for_them(besides: str) -> None:
    data = DatasetSettings(
        scenes=2,
        degradations=1,
        rows=16,
        cols=16,
        kinds=("furniture",),
        shadows=True,
        **{besides: True} if besides else {},
    )
    thin, solid = (samples_of_scene(data.model_copy(update={"solid": s}), 0)[0] for s in (False, True))
    assert np.array_equal(thin.depth_m, solid.depth_m)
    assert not np.array_equal(thin.counts, solid.counts)
