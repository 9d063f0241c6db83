"""Every method of the catalogue keeps the contract; by physics, it sees a point where it is, a shifted one shifted."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
import torch

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.method import MethodResult
from nlos.recon.methods import catalogue, find
from nlos.recon.physics_settings import PhysicsSettings
from nlos.recon.reconstruct import reconstruct

METHODS = [name for name in catalogue() if issubclass(find(name).Settings, PhysicsSettings)]
SETTINGS: dict[str, dict[str, object]] = {
    "gradient_descent": {"iterations": 12, "momentum": True},
    "phasor": {"planes": 96, "cycles": 3},
}
WALL = WallGrid(1.0, 0.84, 21, 25)
TIME = TimeAxis(96, 80e-12)
VOXEL_M = SPEED_OF_LIGHT_M_PER_S * TIME.bin_width_s / 2


def point_scene(
    points: list[tuple[float, float, float]], wall: WallGrid = WALL, time: TimeAxis = TIME, counts: float = 2000.0
) -> Transient:
    """Light from small diffuse patches at (x, y, z), spread over each wall pixel; shares no code with `recon`."""
    fine = (np.arange(6) + 0.5) / 6 - 0.5
    histograms = np.zeros((time.bins, wall.rows, wall.cols))
    for row, y0 in enumerate(wall.y_m()):
        for col, x0 in enumerate(wall.x_m()):
            for x, y, z in points:
                dy = (y0 + fine * wall.height_m / wall.rows - y)[:, None]
                dx = x0 + fine * wall.width_m / wall.cols - x
                r = np.sqrt(dx**2 + dy**2 + z**2)
                k = (2 * r / SPEED_OF_LIGHT_M_PER_S - time.start_s) / time.bin_width_s
                seen, _ = np.histogram(k, bins=time.bins, range=(0, time.bins), weights=r**-4.0)
                histograms[:, row, col] += seen
    histograms *= counts / histograms.max()
    return Transient(histograms.astype(np.float32), np.ones((wall.rows, wall.cols)), wall, time)


def volume(transient: Transient, method: str, **more: object) -> npt.NDArray[np.float32]:
    done = reconstruct(transient, method, {**SETTINGS.get(method, {}), **more})
    assert done.volume is not None
    return done.volume.albedo


@pytest.fixture(scope="module")
def scene() -> tuple[Transient, tuple[int, int, int]]:
    plane, row, col = 55, 12, 9
    z = (plane + 0.5) * VOXEL_M
    return point_scene([(WALL.x_m()[col], WALL.y_m()[row], z)]), (plane, row, col)


@pytest.mark.parametrize("name", catalogue())
def test_every_method_keeps_the_contract(name: str) -> None:
    wall, time = WallGrid(1.0, 0.75, 12, 16), TimeAxis(64, 120e-12)
    method = find(name)
    learned = "weights" in method.Settings.model_fields
    torch.manual_seed(0)  # of an untrained network's weights
    module = method.build(method.Settings.model_validate({"weights": None} if learned else {}), wall, time).eval()
    counts = torch.poisson(torch.rand(2, 1, 64, 12, 16, generator=torch.Generator().manual_seed(1)) * 5)
    exposure_s = torch.ones(2, 12, 16)
    exposure_s[0, 3:5], counts[0, :, :, 3:5] = 0, 0
    with torch.inference_mode():
        whole = module(counts, exposure_s)
        alone = module(counts[1:], None)
    assert isinstance(whole, MethodResult)
    assert whole.albedo.shape == whole.depth_m.shape == (2, 12, 16)
    assert torch.isfinite(whole.albedo).all()
    assert not torch.isinf(whole.depth_m).any()
    torch.testing.assert_close(whole.albedo[1:], alone.albedo, rtol=1e-3, atol=1e-4 * float(alone.albedo.max()))
    depths_m = np.asarray(module.depths_m)
    assert (np.diff(depths_m) > 0).all()
    assert depths_m[0] <= whole.depth_m.nan_to_num(depths_m[0]).min()
    if whole.volume is not None:
        assert whole.volume.shape == (2, len(depths_m), 12, 16)
        assert torch.isfinite(whole.volume).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_point_scene_reconstructs_to_its_voxel(method: str, scene: tuple[Transient, tuple[int, int, int]]) -> None:
    transient, (plane, row, col) = scene
    done = reconstruct(transient, method, SETTINGS.get(method, {}))
    assert np.unravel_index(done.albedo.argmax(), done.albedo.shape) == (row, col)
    assert done.depth_m[row, col] == pytest.approx((plane + 0.5) * VOXEL_M, abs=VOXEL_M / 2)


@pytest.mark.parametrize("method", METHODS)
def test_a_mirrored_scene_gives_the_mirrored_picture(
    method: str, scene: tuple[Transient, tuple[int, int, int]]
) -> None:
    rng = np.random.default_rng(5)
    noisy = rng.poisson(scene[0].counts + 0.5).astype(np.float32)
    straight = volume(replace(scene[0], counts=noisy), method)
    tolerance = 2e-4 if method == "gradient_descent" else 2e-5  # its line search amplifies rounding
    for axis in (1, 2):
        mirrored = volume(replace(scene[0], counts=np.ascontiguousarray(np.flip(noisy, axis))), method)
        assert np.abs(np.flip(mirrored, axis) - straight).max() <= tolerance * straight.max()


@pytest.mark.parametrize("method", METHODS)
def test_a_shifted_scene_shifts(method: str, scene: tuple[Transient, tuple[int, int, int]]) -> None:
    _, (plane, row, col) = scene
    z = (plane + 0.5) * VOXEL_M
    moved = point_scene([(WALL.x_m()[col + 3], WALL.y_m()[row - 2], z)])
    assert np.unravel_index(volume(moved, method).max(0).argmax(), (21, 25)) == (row - 2, col + 3)
    half = point_scene([((WALL.x_m()[col] + WALL.x_m()[col + 1]) / 2, WALL.y_m()[row], z)])
    front = volume(half, method).max(0)
    assert front[row, col] == pytest.approx(front[row, col + 1], rel=0.12)


@pytest.mark.parametrize("method", METHODS)
def test_counts_may_be_scaled_and_the_picture_scales(
    method: str, scene: tuple[Transient, tuple[int, int, int]]
) -> None:
    straight = reconstruct(scene[0], method, SETTINGS.get(method, {})).albedo
    for factor in (7, 1e-25):  # such are units of joules, of somebody's rendering
        counts = scene[0].counts * np.float32(factor)
        scaled = reconstruct(replace(scene[0], counts=counts), method, SETTINGS.get(method, {})).albedo
        assert np.abs(scaled / factor - straight).max() <= 1e-4 * straight.max()


def test_nano_sees_light_in_any_units(scene: tuple[Transient, tuple[int, int, int]]) -> None:
    straight = reconstruct(scene[0], "nano", explain=False).albedo
    faint = replace(scene[0], counts=scene[0].counts * np.float32(1e-25))
    assert straight.max() == 1
    assert np.abs(reconstruct(faint, "nano", explain=False).albedo - straight).max() <= 1e-3


@pytest.mark.parametrize("method", METHODS)
def test_twice_the_exposure_is_not_twice_the_albedo(method: str, scene: tuple[Transient, tuple[int, int, int]]) -> None:
    transient = scene[0]
    exposure_s = np.ones((21, 25))
    exposure_s[:, 12:] = 2
    uneven = replace(transient, counts=transient.counts * exposure_s.astype(np.float32), exposure_s=exposure_s)
    even = reconstruct(transient, method, SETTINGS.get(method, {})).albedo
    again = reconstruct(uneven, method, SETTINGS.get(method, {})).albedo
    assert np.abs(again / again.max() - even / even.max()).max() <= 1e-4


@pytest.mark.parametrize("method", METHODS)
def test_a_window_that_starts_late_changes_nothing_but_the_depth_axis(
    method: str, scene: tuple[Transient, tuple[int, int, int]]
) -> None:
    transient, (plane, row, col) = scene
    late = replace(transient, counts=transient.counts[24:], time=TimeAxis(72, 80e-12, 24 * 80e-12))
    done = reconstruct(late, method, SETTINGS.get(method, {}))
    assert np.unravel_index(done.albedo.argmax(), done.albedo.shape) == (row, col)
    assert done.depth_m[row, col] == pytest.approx((plane + 0.5) * VOXEL_M, abs=VOXEL_M / 2)
