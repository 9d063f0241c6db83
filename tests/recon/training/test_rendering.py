"""The renderer against somebody else's path tracer, against closed forms, and against itself."""

from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import Scene, Surfels, make_scene, surfels
from nlos.recon.training.second_bounce import render_second_bounce, thinned
from nlos.recon.training.visibility import visibility

SYNTHETIC = Path(__file__).parents[4] / "shared" / "data" / "synthetic"
SCENES = ("bunny", "bear", "bust", "letters_su", "bicycle", "staircase", "bear_letter")
SPLIT = 3


def surfels_of_truth(data: h5py.File) -> Surfels:
    """3 x 3 surfels per pixel of the published front views: depth and coverage as given, |cos| from the intensity."""
    depth = data["gt_depth"][...]
    coverage = data["gt_coverage"][...] * (depth > 0)
    albedo = data["gt_albedo"][...]
    cosine = np.clip(data["gt_intensity"][...] / np.maximum(albedo * data["gt_coverage"][...], 1e-6), 0.15, 1)
    pitch = 2.0 / 64
    slope = []
    for axis, sign in ((1, 1.0), (0, -1.0)):
        ahead, behind = np.roll(depth, -1, axis), np.roll(depth, 1, axis)
        forward = np.where((ahead > 0) & (np.abs(ahead - depth) < 0.15), ahead - depth, np.nan)
        backward = np.where((behind > 0) & (np.abs(depth - behind) < 0.15), depth - behind, np.nan)
        both = np.stack((forward, backward))
        mean = np.where(np.isfinite(both).any(0), np.nansum(both, 0) / np.maximum(np.isfinite(both).sum(0), 1), 0)
        slope.append(sign * mean / pitch)
    steep = np.hypot(*slope)
    true = np.sqrt(1 / cosine**2 - 1)
    scale = np.where(steep > 1e-6, np.minimum(true / np.maximum(steep, 1e-6), 3.0), 0.0)
    normal = np.stack((slope[0] * scale, slope[1] * scale, -np.ones_like(depth)))
    normal /= np.linalg.norm(normal, axis=0)
    row, col = np.nonzero(coverage > 0)
    grid = WallGrid(2.0, 2.0, 64, 64)
    pieces = []
    for i in range(SPLIT):
        for j in range(SPLIT):
            dx, dy = ((j + 0.5) / SPLIT - 0.5) * pitch, (0.5 - (i + 0.5) / SPLIT) * pitch
            z = depth[row, col] + slope[0][row, col] * dx + slope[1][row, col] * dy
            pieces.append(np.stack((grid.x_m()[col] + dx, grid.y_m()[row] + dy, z), axis=1))
    weight = albedo * coverage / cosine * (pitch / SPLIT) ** 2
    return Surfels(
        position_m=np.concatenate(pieces).astype(np.float32),
        normal=np.tile(normal[:, row, col].T, (SPLIT**2, 1)).astype(np.float32),
        weight_m2=np.tile(weight[row, col], SPLIT**2).astype(np.float32),
    )


def correlation(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> float:
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


@pytest.mark.skipif(not SYNTHETIC.exists(), reason="needs ../shared/data/synthetic beside the repository")
@pytest.mark.parametrize("name", SCENES)
def test_same_surfaces_give_the_path_tracers_transient(name: str) -> None:
    with h5py.File(SYNTHETIC / f"{name}.h5") as data:
        theirs = np.moveaxis(data["transient"][...], 2, 0)
        ours = render(surfels_of_truth(data), WallGrid(2.0, 2.0, 64, 64), TimeAxis(512, 32e-12)).numpy()
    assert correlation(ours, theirs) >= 0.95
    rebinned = [t.reshape(128, 4, 64, 64).sum(axis=1) for t in (ours, theirs)]
    assert correlation(*rebinned) >= 0.985
    assert np.corrcoef(ours.sum(0).ravel(), theirs.sum(0).ravel())[0, 1] > 0.99


def one_surfel(x: float = 0.1, y: float = -0.2, z: float = 0.9) -> Surfels:
    return Surfels(np.float32([[x, y, z]]), np.float32([[0, 0, -1]]), np.float32([0.7]))


@pytest.mark.parametrize(("retroreflective", "exponent"), [(False, 8), (True, 4)])
def test_one_surfel_arrives_in_its_bin_with_its_closed_form_weight(retroreflective: bool, exponent: int) -> None:
    wall, time = WallGrid(1.0, 2.0, 8, 4), TimeAxis(300, 32e-12, start_s=1e-9)
    got = render(one_surfel(), wall, time, retroreflective=retroreflective).numpy()
    r = np.sqrt((wall.x_m()[None] - 0.1) ** 2 + (wall.y_m()[:, None] + 0.2) ** 2 + 0.81)
    power = 4 if not retroreflective else 2
    expected = 0.7 * 0.9**power / r**exponent
    np.testing.assert_allclose(got.sum(axis=0), expected, rtol=2e-5)
    bin_ = np.floor((2 * r / SPEED_OF_LIGHT_M_PER_S - time.start_s) / time.bin_width_s)
    np.testing.assert_array_equal(got.argmax(axis=0), bin_)


def test_what_lies_outside_the_time_axis_or_faces_away_is_dropped() -> None:
    wall = WallGrid(1.0, 1.0, 4, 4)
    assert render(one_surfel(z=3.0), wall, TimeAxis(100, 32e-12)).sum() == 0
    assert render(one_surfel(), wall, TimeAxis(100, 32e-12, start_s=9e-9)).sum() == 0
    away = Surfels(np.float32([[0, 0, 0.5]]), np.float32([[0, 0, 1]]), np.float32([1]))
    assert render(away, wall, TimeAxis(300, 32e-12)).sum() == 0


def test_light_adds_up_and_mirrors_with_the_scene() -> None:
    wall, time = WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12)
    both = Surfels(*(np.concatenate(pair) for pair in zip(_parts(0.3), _parts(-0.6), strict=True)))
    alone = render(one_surfel(0.3), wall, time) + render(one_surfel(-0.6), wall, time)
    np.testing.assert_allclose(render(both, wall, time), alone, rtol=1e-5)
    np.testing.assert_allclose(
        render(one_surfel(-0.3), wall, time), render(one_surfel(0.3), wall, time).flip(2), rtol=1e-4
    )


def _parts(x: float) -> tuple[npt.NDArray[np.float32], ...]:
    surfel = one_surfel(x)
    return surfel.position_m, surfel.normal, surfel.weight_m2


def wall_with_a_screen() -> Scene:
    """A sheet at 1.2 m over the whole view, and before its right half another at 0.6 m."""
    grid = WallGrid(2.0, 2.0, 64, 64)
    depth = np.full((64, 64), 1.2, np.float32)
    depth[:, 32:] = 0.6
    ones, normal = np.ones_like(depth), np.zeros((3, 64, 64), np.float32)
    normal[2] = -1
    return Scene("screen", grid, depth, normal, ones, ones)


def test_a_screen_hides_what_lies_behind_it_and_nothing_else() -> None:
    scene = wall_with_a_screen()
    pieces = Surfels(
        np.array([[-0.5, 0.0, 1.2], [-0.05, 0.0, 1.2], [0.5, 0.0, 0.6]], np.float32),
        np.array([[0, 0, -1]] * 3, np.float32),
        np.ones(3, np.float32),
    )
    seen = visibility(scene, pieces, WallGrid(2.0, 2.0, 16, 16))
    assert seen[0, :, :4].all()  # straight ahead and to its left
    assert seen[2].all()  # the screen itself
    assert not seen[1, 4, 6:].any()  # past the edge of the screen, far to the right
    assert seen[1, 4, :4].all()


def test_shadows_take_light_away_only_where_something_stands_before() -> None:
    wall, time = WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12)
    scene = wall_with_a_screen()
    pieces = surfels(scene, np.random.default_rng(0))
    free = render(pieces, wall, time)
    shaded = render(pieces, wall, time, seen=visibility(scene, pieces, wall))
    assert (shaded <= free * (1 + 1e-5)).all()
    lost = 1 - shaded.sum(0) / free.sum(0)
    assert lost[:, -1].mean() > lost[:, 0].mean() > -1e-6
    nearest = int(2 * 0.6 / SPEED_OF_LIGHT_M_PER_S / time.bin_width_s)
    np.testing.assert_allclose(shaded[nearest, :, 12], free[nearest, :, 12], rtol=1e-4)  # the screen in front is whole


def test_two_facing_surfels_exchange_their_closed_form_light() -> None:
    a = 2**-0.5
    pair = Surfels(
        np.array([[-0.3, 0, 1.0], [0.3, 0, 1.0]], np.float32),
        np.array([[a, 0, -a], [-a, 0, -a]], np.float32),
        np.array([0.01, 0.02], np.float32),
    )
    wall, time = WallGrid(0.1, 0.1, 1, 1), TimeAxis(400, 32e-12)
    got = render_second_bounce(pair, wall, time)[:, 0, 0]
    r2 = 1 + 0.3**2
    lit = (a * 0.3 + a) / r2**2  # cos cos / r^2 of either
    expected = 2 * (0.01 * lit) * (0.02 * lit) * a * a / 0.6**2 / np.pi
    assert float(got.sum()) == pytest.approx(expected, rel=1e-4)
    assert int(got.argmax()) == int((2 * r2**0.5 + 0.6) / SPEED_OF_LIGHT_M_PER_S / time.bin_width_s)


def test_thinned_surfels_weigh_what_all_did() -> None:
    scene = make_scene(1, 3, WallGrid(2.0, 2.0, 32, 32))
    pieces = surfels(scene, np.random.default_rng(0))
    few = thinned(pieces, 50, np.random.default_rng(1))
    assert few.weight_m2.size == 50
    assert few.weight_m2.sum() == pytest.approx(pieces.weight_m2.sum(), rel=1e-4)


@pytest.mark.skipif(not SYNTHETIC.exists(), reason="needs ../shared/data/synthetic beside the repository")
def test_the_second_bounce_is_as_strong_as_the_path_tracers() -> None:
    wall, time = WallGrid(2.0, 2.0, 64, 64), TimeAxis(128, 128e-12)
    with h5py.File(SYNTHETIC / "bear_letter.h5") as data:
        single, double = (data[name][...].sum() for name in ("transient", "transient_multibounce"))
        pieces = surfels_of_truth(data)
    first = float(render(pieces, wall, time).sum())
    second = float(render_second_bounce(thinned(pieces, 160, np.random.default_rng(0)), wall, time).sum())
    # Front surfaces only: the path tracer's light also meets the backs of the objects.
    assert 0.3 < (second / first) / (double / single - 1) < 2
