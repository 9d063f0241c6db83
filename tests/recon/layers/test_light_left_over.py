"""What the light says of a picture: against a renderer of its own, and against pictures that are wrong on purpose."""

import numpy as np
import pytest
import torch
from scipy.ndimage import convolve1d
from scipy.optimize import nnls

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.explained_surface import surface_light
from nlos.recon.layers.light_left_over import CHANNELS, SMOOTH, LightLeftOver, _best
from nlos.recon.layers.refinement import Correction, Refinement
from nlos.recon.layers.surface_light import Axis, arriving, paths, surface_of

WALL, TIME = WallGrid(2.0, 2.0, 32, 32), TimeAxis(256, 64e-12)
GAIN, DARK = 400.0, 0.5


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A slanted bar and a square behind it: brightness and depth in metres, NaN where nothing is."""
    albedo, depth = np.zeros((32, 32), np.float32), np.full((32, 32), np.nan, np.float32)
    albedo[6:10, 4:26] = 1.0
    depth[6:10, 4:26] = 0.8 + 0.01 * np.arange(22)
    albedo[18:26, 12:20], depth[18:26, 12:20] = 0.6, 1.3
    return albedo, depth


def counted(albedo: np.ndarray, depth: np.ndarray, falloff: float = 4.0, seed: int = 0,
            taps: np.ndarray | None = None, dwell: np.ndarray | float = 1.0) -> torch.Tensor:  # fmt: skip
    """Photons drawn from the other renderer, (T, H, W)."""
    points = np.argwhere(np.ones((32, 32), bool))
    light = surface_light(albedo, depth, WALL, points, TIME, falloff).reshape(256, 32, 32)
    rate = GAIN * light / light.max()
    if taps is not None:
        rate = convolve1d(rate, taps, axis=0, mode="constant")
    return torch.from_numpy(np.random.default_rng(seed).poisson((rate + DARK) * dwell).astype(np.float32))


def look(counts: torch.Tensor, albedo: np.ndarray, depth: np.ndarray, exposure: torch.Tensor | None = None,
         falloff: float = 4.0, response: torch.Tensor | None = None) -> dict[str, torch.Tensor]:  # fmt: skip
    found = LightLeftOver(WALL, TIME, falloff)(
        counts, torch.ones(32, 32) if exposure is None else exposure, torch.from_numpy(albedo),
        torch.from_numpy(depth) / 2.0, response,
    )  # fmt: skip
    assert found is not None
    return dict(zip(CHANNELS, found, strict=True))


@pytest.mark.parametrize("falloff", [4.0, 2.0])
def test_light_of_a_surface_is_that_of_the_other_renderer(falloff: float) -> None:
    albedo, depth = scene()
    seen = torch.from_numpy(albedo > 0)
    x, y = (torch.from_numpy(each / 2.0).float() for each in (WALL.x_m(), WALL.y_m()))
    surface = surface_of(torch.from_numpy(albedo), torch.from_numpy(depth) / 2.0, seen, seen, x, y)
    axis = Axis(0.0, SPEED_OF_LIGHT_M_PER_S * TIME.bin_width_s / 2 / 2.0, TIME.bins)
    points = np.argwhere(np.ones((32, 32), bool))[::37]
    way = paths(surface, x[points[:, 1]], y[points[:, 0]], axis, falloff)
    ours = arriving(way, surface.albedo, axis).T.numpy()
    theirs = surface_light(albedo, depth, WALL, points, TIME, falloff)
    ours *= theirs.sum() / ours.sum()
    assert np.abs(ours.sum(axis=0) / theirs.sum(axis=0) - 1).max() < 0.03  # edges: the slope of what is not there
    late, early = np.cumsum(ours, axis=0), np.cumsum(theirs, axis=0)
    assert np.abs(late[1:] - early[1:]).max() < 0.6 * theirs.max()  # no more than half a bin of light apart


def test_a_surface_leans_as_its_depths_do_and_not_over_an_edge() -> None:
    x, y = (torch.from_numpy(each / 2.0).float() for each in (WALL.x_m(), WALL.y_m()))
    everywhere = torch.ones(32, 32, dtype=torch.bool)
    plane = 0.7 + 0.3 * x + 0.2 * y[:, None] + 0.5 * (x > 0)
    surface = surface_of(torch.ones(32, 32), plane, everywhere, everywhere, x, y)
    torch.testing.assert_close(surface.across, torch.full((1024,), 0.3), atol=1e-4, rtol=0)
    torch.testing.assert_close(surface.up, torch.full((1024,), 0.2), atol=1e-4, rtol=0)


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("falloff", [4.0, 2.0])
def test_brightness_that_is_wrong_is_pulled_back(sparse: bool, falloff: float) -> None:
    albedo, depth = scene()
    counts = counted(albedo, depth, falloff)
    exposure = torch.ones(32, 32)
    if sparse:
        exposure = exposure * (torch.arange(32)[:, None] % 2 == 0) * (torch.arange(32) % 2 == 0)
        counts = counts * exposure
    wrong = albedo.copy()
    wrong[6:10, 4:12] *= 0.5
    wrong[6:10, 20:26] *= 1.5
    ratio = look(counts, wrong, depth, exposure, falloff)["ratio"]
    assert ratio[6:10, 5:11].mean() > 0.05 > -0.03 > ratio[6:10, 21:25].mean()


@pytest.mark.parametrize("off_m", [-0.01, 0.01])
def test_depth_that_is_wrong_is_pulled_back(off_m: float) -> None:
    albedo, depth = scene()
    found = look(counted(albedo, depth), albedo, depth + off_m)
    assert float(found["depth_step"][7:9, 6:24].mean()) * off_m < 0
    assert float(found["depth_step"][20:24, 14:18].mean()) * off_m < 0


def test_a_picture_that_is_right_is_left_alone() -> None:
    albedo, depth = scene()
    found = look(counted(albedo, depth), albedo, depth)
    seen = torch.from_numpy(albedo > 0)
    assert found["change"][seen].abs().mean() < 0.03
    assert abs(float(found["misfit"][0, 0])) < 0.05  # what is left is noise


def test_a_slow_response_is_found_and_one_that_is_told_is_used() -> None:
    albedo, depth = scene()
    taps = np.exp(-0.5 * (np.arange(-9, 10) / 2.5) ** 2)
    taps /= taps.sum()
    slow = counted(albedo, depth, taps=taps)
    untold, told = look(slow, albedo, depth), look(slow, albedo, depth, response=torch.from_numpy(taps))
    assert float(untold["width"][0, 0]) > 0
    assert float(told["width"][0, 0]) == 0
    assert float(untold["misfit"][0, 0]) < 0.1  # as wide as it was found, it is what the rest is rendered with
    assert float(told["misfit"][0, 0]) < 0.05  # what is left is noise
    assert float(look(slow, albedo, depth + 0.05)["misfit"][0, 0]) > 0.2


def test_light_far_wider_than_told_says_nothing_of_a_picture() -> None:
    albedo, depth = scene()
    taps = np.exp(-0.5 * (np.arange(-30, 31) / 10.0) ** 2)
    taps /= taps.sum()
    slow, pictured = counted(albedo, depth, taps=taps), (torch.from_numpy(albedo), torch.from_numpy(depth) / 2.0)
    left_over = LightLeftOver(WALL, TIME, 4.0)
    assert left_over(slow, torch.ones(32, 32), *pictured, None) is None
    assert left_over(slow, torch.ones(32, 32), *pictured, torch.from_numpy(taps).float()) is not None


@pytest.mark.parametrize("unit", [7.0, 1000.0])
def test_the_unit_of_the_counts_changes_nothing(unit: float) -> None:
    albedo, depth = scene()
    counts = counted(albedo, depth)
    one, other = (
        look(counts, albedo * 0.9 + 0.1 * (albedo > 0), depth),
        look(unit * counts, albedo * 0.9 + 0.1 * (albedo > 0), depth),
    )
    for name in CHANNELS:
        torch.testing.assert_close(one[name], other[name], atol=2e-3, rtol=1e-3)


def test_an_untrained_correction_changes_nothing_and_nothing_to_see_stays_so() -> None:
    albedo, depth = scene()
    counts = counted(albedo, depth)[None, None]
    refinement = Refinement(Correction(), WALL, TIME, 4.0)
    for picture, deep in ((albedo, depth), (np.zeros_like(albedo), depth), (albedo, np.full_like(depth, np.nan))):
        seen = refinement(counts, None, None, torch.from_numpy(picture)[None], torch.from_numpy(deep)[None] / 2.0)
        torch.testing.assert_close(seen.albedo[0], torch.from_numpy(picture), atol=1e-6, rtol=0)
        known = torch.from_numpy((picture > 0) & np.isfinite(deep))
        torch.testing.assert_close(seen.depth[0][known], torch.from_numpy(deep / 2.0)[known], atol=1e-6, rtol=0)


def test_a_record_that_begins_late_says_the_same() -> None:
    albedo, depth = scene()
    counts, wrong, late = counted(albedo, depth), albedo * 0.9 + 0.1 * (albedo > 0), 60
    whole = look(counts, wrong, depth + 0.01)
    time = TimeAxis(TIME.bins - late, TIME.bin_width_s, late * TIME.bin_width_s)
    found = LightLeftOver(WALL, time, 4.0)(
        counts[late:], torch.ones(32, 32), torch.from_numpy(wrong), torch.from_numpy(depth + 0.01) / 2.0, None
    )
    assert found is not None
    for name, values in zip(CHANNELS, found, strict=True):
        torch.testing.assert_close(values, whole[name], atol=0.08, rtol=0)  # fewer bins tell the background


def test_points_looked_at_for_longer_and_those_that_were_not_leave_a_right_picture_alone() -> None:
    albedo, depth = scene()
    dwell = np.where(np.add.outer(np.arange(32), np.arange(32)) % 3 == 0, 4.0, 0.2)
    dwell[::5] = 0.0
    counts, exposure = counted(albedo, depth, dwell=dwell), torch.from_numpy(dwell).float()
    found, seen = look(counts, albedo, depth, exposure), torch.from_numpy(albedo > 0)
    assert found["change"][seen].abs().mean() < 0.03
    assert abs(float(found["misfit"][0, 0])) < 0.1
    counts[:, ::5] = 1e4  # whatever stands where nothing was measured
    for name, values in look(counts, albedo, depth, exposure).items():
        torch.testing.assert_close(values, found[name], atol=1e-5, rtol=1e-5)


def test_a_response_with_a_tail_is_undone_the_right_way_round() -> None:
    albedo, depth = scene()
    taps = np.where(np.arange(-30, 31) >= 0, np.exp(-np.arange(-30, 31) / 8.0), 0.0)
    taps /= taps.sum()
    wrong = albedo.copy()
    wrong[6:10, 4:12] *= 0.5
    counts, told = counted(albedo, depth, taps=taps), torch.from_numpy(taps).float()
    assert look(counts, wrong, depth, response=told)["ratio"][6:10, 5:11].mean() > 0.1
    for off_m in (-0.01, 0.01):
        step = look(counts, albedo, depth + off_m, response=told)["depth_step"]
        assert float(step[7:9, 6:24].mean()) * off_m < 0


def test_how_certain_brightness_is_said_to_be_is_how_it_scatters() -> None:
    albedo, depth = scene()
    seen = torch.from_numpy(albedo > 0)
    for seed in range(2):
        found = look(counted(albedo, depth, seed=seed), albedo, depth)
        in_errors = 4 * found["step"] / torch.from_numpy(albedo) * 10 ** (2 * found["certainty"])
        assert 0.7 < float(in_errors[seen].std()) < 2.5  # pixels share light: a little more than for each alone


def test_brightness_that_is_off_by_a_power_of_depth_explains_the_light() -> None:
    albedo, depth = scene()
    bent = (albedo * np.nan_to_num(depth, nan=1.0) ** 2).astype(np.float32)
    found = look(counted(albedo, depth), bent / bent.max(), depth)
    assert float(found["misfit"][0, 0]) < 0.05
    assert found["ratio"][torch.from_numpy(albedo > 0)].abs().mean() < 0.05


def test_what_is_faint_is_asked_about_too() -> None:
    albedo, depth = scene()
    albedo[18:26, 12:20] = 0.05
    found = look(counted(albedo, depth), albedo, depth)
    assert (found["known"] == torch.from_numpy(albedo > 0)).all()


def test_gain_and_background_are_the_best_that_are_not_negative() -> None:
    rng = np.random.default_rng(3)
    flat = np.ones((6, 40))
    for case in range(12):
        models = [rng.random((6, 40)) ** power for power in (1, 4, 0.1)]
        light = rng.poisson(5 * models[case % 3] + (0.0, 4.0)[case % 2])
        light = light * (models[case % 3] > 0.3 * (case > 5))  # dark where the picture has some: no background fits
        given, floor = torch.from_numpy(light), torch.tensor(0.5)
        smooth = convolve1d(light.astype(float), SMOOTH, axis=1, mode="constant")
        weight = np.sqrt(1 / (0.5 * smooth + 0.5 * smooth.mean(axis=0) + 0.5)).ravel()
        truth = [
            nnls(np.stack([model.ravel(), flat.ravel()], axis=1) * weight[:, None], light.ravel() * weight)
            for model in models
        ]
        which = int(np.argmin([misfit for _, misfit in truth]))
        found = _best(given.double(), [torch.from_numpy(each) for each in models], torch.from_numpy(flat), floor)
        assert found is not None
        assert found.which == which
        assert (found.gain, found.background) == pytest.approx(tuple(truth[which][0]), rel=1e-5, abs=1e-7)


def test_a_refinement_hands_on_how_long_points_were_looked_at_and_through_what() -> None:
    albedo, depth = scene()
    taps = np.exp(-0.5 * (np.arange(-9, 10) / 2.5) ** 2)
    taps /= taps.sum()
    dwell = np.where(np.arange(32) % 2 == 0, 3.0, 0.5) * np.ones((32, 1))
    counts, told = counted(albedo, depth, taps=taps, dwell=dwell)[None, None], torch.from_numpy(taps).float()[None]
    pictures = torch.from_numpy(albedo)[None], torch.from_numpy(depth)[None] / 2.0
    seen = Refinement(Correction(), WALL, TIME, 4.0)(counts, 7e-3 * torch.from_numpy(dwell)[None], told, *pictures)
    assert abs(float(seen.found[0, CHANNELS.index("misfit"), 0, 0])) < 0.1
    assert float(seen.found[0, CHANNELS.index("width"), 0, 0]) == 0
