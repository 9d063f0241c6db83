"""What an adjoint test cannot see: that operators do what they are named after, against closed forms by other means."""

import numpy as np
import pytest
import torch

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport.falloff import Falloff
from nlos.recon.transport.falloff_weights import falloff_weights
from nlos.recon.transport.fk_migration import FkMigration
from nlos.recon.transport.light_cone import LightConeConvolution
from nlos.recon.transport.phasor_field import ConfocalRsd, frequencies_per_m
from nlos.recon.transport.resampling import LightConeResampling
from nlos.recon.transport.resampling_matrix import resampling_matrix
from nlos.recon.transport.response_bands import bands_of, plane_brightness
from nlos.recon.transport.response_on_cone import ResponseOnCone

TIME = TimeAxis(400, 32e-12)
LOPSIDED = np.array([0.0, 0.1, 0.15, 0.3, 0.0, 0.0, 0.1, 0.1, 0.1, 0.1, 0.05])


def over_time(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(values)[None, None, :, None, None]


@pytest.mark.parametrize("centre", [90, 180, 330])
def test_a_response_on_the_cone_is_the_response_in_time(centre: int) -> None:
    """Spread in time and then brought onto the cone, or the other way round; the response's middle tap is on time."""
    matrix = resampling_matrix(TIME, "physical")
    cells = matrix.shape[0]
    pulse = np.exp(-0.5 * ((np.arange(400) - centre) / 8.0) ** 2)
    bands = bands_of(np.eye(400)[60], 6, LOPSIDED, TIME, cells, 2 * cells)
    onto_cone, on_cone = LightConeResampling(TIME), ResponseOnCone(bands, matrix, 2 * cells)
    expected = onto_cone(over_time(np.convolve(pulse, LOPSIDED, mode="same"))).flatten().numpy()
    found = on_cone(onto_cone(over_time(pulse))).flatten().numpy()
    assert np.abs(found - expected).max() < 0.05 * expected.max()
    cell = np.arange(cells)
    assert (found * cell).sum() / found.sum() == pytest.approx((expected * cell).sum() / expected.sum(), abs=0.4)


def test_points_too_far_apart_for_the_window_see_nothing_of_each_other() -> None:
    """1.35 m of path in all on a wall of 3 m: beyond a pixel or two light comes later than the record ends."""
    wall, time = WallGrid(3.0, 3.0, 6, 6), TimeAxis(9, 100e-12)
    cone = LightConeConvolution(wall, time)
    u = torch.zeros(1, 1, cone.cells, 6, 6, dtype=torch.float64)
    u[0, 0, 1, 0, 0] = 1.0
    seen = cone(u)[0, 0].abs().amax(dim=0).numpy()
    away_m = np.hypot(*np.indices((6, 6))) * 0.5 - np.sqrt(0.5)  # between the nearest corners
    reach_m = 9 * 100e-12 * SPEED_OF_LIGHT_M_PER_S / 2
    assert (away_m > reach_m).sum() > 10
    assert seen[away_m > reach_m].max() < 1e-3 * seen.max()


def test_no_light_comes_before_it_has_left() -> None:
    """From the end of the window it reaches far points after it: beyond the record, and not at its beginning."""
    wall, time = WallGrid(1.4, 1.4, 9, 9), TimeAxis(40, 100e-12)
    cone = LightConeConvolution(wall, time)
    u = torch.zeros(1, 1, cone.cells, 9, 9, dtype=torch.float64)
    u[0, 0, :, 0, 0] = torch.from_numpy(np.exp(-0.5 * ((np.arange(cone.cells) - 32.0) / 2.0) ** 2))
    seen = cone(u)[0, 0].abs().numpy()
    assert seen[:22].max() < 1e-3 * seen.max()


def test_a_delay_that_the_response_tells_is_taken_back() -> None:
    wall, time = WallGrid(0.5, 0.4, 3, 2), TimeAxis(40, 200e-12)
    cone = LightConeConvolution(wall, time)
    y = torch.zeros(1, 1, cone.cells, 3, 2, dtype=torch.float64)
    y[0, 0, 8:20] = torch.rand(12, 3, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    cycles = torch.arange(cone.padded[0] // 2 + 1, dtype=torch.float64) / cone.padded[0]
    delay = torch.exp(-2j * torch.pi * 5 * cycles)[None, None]
    found, expected = cone.wiener(y.roll(5, 2), 3.0, delay), cone.wiener(y, 3.0)
    assert torch.allclose(found, expected, atol=1e-9 * float(expected.abs().max()))
    twice = cone.wiener(y, 3.0, 2.0 * torch.ones_like(delay))  # |2 H|^2 + 1 / 3 is four times |H|^2 + 1 / 12
    assert torch.allclose(twice, cone.wiener(y, 12.0) / 2)


def test_a_prior_of_small_gradients_is_one_of_neighbours_differences() -> None:
    """At an snr so low that only the prior is left: (flatness + squared gradient) z = H* y, away from the edges."""
    wall, time = WallGrid(0.6, 0.5, 7, 6), TimeAxis(16, 200e-12)
    cone = LightConeConvolution(wall, time)
    y = torch.rand(1, 1, cone.cells, 7, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(5))
    snr = torch.tensor([1e-7], dtype=torch.float64)
    z = (cone.gram_inverse(y, snr, 3.0) / snr)[0, 0].numpy()
    inside = (slice(1, -1),) * 3
    curved = sum(np.roll(z, 1, axis) + np.roll(z, -1, axis) - 2 * z for axis in range(3))
    expected = cone.adjoint(y)[0, 0].numpy()
    assert (3.0 * z - curved / 4)[inside] == pytest.approx(expected[inside], rel=1e-4, abs=1e-5 * expected.max())


def test_the_part_of_the_falloff_that_is_undone_is_a_part_of_its_exponent() -> None:
    time = TimeAxis(10, 100e-12)
    ones = torch.ones(2, 1, 10, 1, 1, dtype=torch.float64)
    relative = (np.arange(10) + 0.5) / 10
    assert Falloff(time, 4.0)(ones)[0].flatten().numpy() == pytest.approx(relative**4)
    assert falloff_weights(time, 4.0) == pytest.approx(relative**4)
    part = Falloff(time, 4.0)(ones, torch.tensor([0.5, 0.25]))
    assert part[:, 0, :, 0, 0].numpy() == pytest.approx(np.stack([relative**2, relative]))


def test_a_plane_is_as_bright_as_what_of_its_spectrum_is_inverted() -> None:
    power, noise = np.array([4.0, 2.0, 1.0]), 0.5
    spectra = np.array([[1.0, 1.0, 1.0], [1.0, 0.5, 0.0]])
    inverted = [4 / 4.5 + 2 * (2 / 2.5 + 1 / 1.5), 4 / 4.5 + 2 * 0.5 / (0.5 + 0.5)]
    assert plane_brightness(power, spectra, noise) == pytest.approx([1.0, inverted[1] / inverted[0]])


@pytest.mark.parametrize("start_s", [0.0, 0.6e-9])
def test_a_plane_wave_migrates_to_half_of_its_way(start_s: float) -> None:
    migration = FkMigration(WallGrid(20.0, 20.0, 8, 8), TimeAxis(64, 100e-12, start_s))
    for at in (5, 32, 58):
        wave = np.exp(-0.5 * ((np.arange(64) - at) / 1.5) ** 2)
        image = migration(over_time(wave).expand(1, 1, 64, 8, 8).contiguous())[0, 0].abs()[:, 4, 4]
        assert int(image.argmax()) == at


@pytest.mark.parametrize("start_s", [0.0, 0.6e-9])
def test_plane_waves_migrate_as_bright_from_everywhere_in_the_window(start_s: float) -> None:
    wall, time, at = WallGrid(2.0, 2.0, 32, 32), TimeAxis(256, 64e-12, start_s), np.array([12, 40, 128, 200, 245])
    bright = []
    for pulse in np.exp(-0.5 * (np.arange(256) - at[:, None]) ** 2):
        image = FkMigration(wall, time)(over_time(pulse).expand(1, 1, 256, 32, 32).contiguous())[0, 0]
        bright.append(float(image.abs().square()[:, 14:18, 14:18].amax(dim=0).mean()))
    assert np.array(bright) / np.mean(bright) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize(("start_s", "at"), [(0.0, 14.0), (0.0, 14.5), (0.0, 39.5), (0.5e-9, 7.75), (0.5e-9, 17.55)])
def test_migration_puts_a_point_at_its_depth_to_a_twentieth_of_a_bin(start_s: float, at: float) -> None:
    wall, time = WallGrid(1.2, 1.2, 33, 33), TimeAxis(96, 80e-12, start_s)
    bin_m = SPEED_OF_LIGHT_M_PER_S * time.bin_width_s / 2
    depth_m = (at + 0.5) * bin_m + start_s * SPEED_OF_LIGHT_M_PER_S / 2
    away_m = np.sqrt(wall.x_m() ** 2 + wall.y_m()[:, None] ** 2 + depth_m**2)
    off = (np.arange(96)[:, None, None] - (away_m - depth_m) / bin_m - at) / 1.2
    wave = torch.from_numpy((1 - off**2) * np.exp(-0.5 * off**2) * (depth_m / away_m) ** 2)
    power = FkMigration(wall, time)(wave[None, None])[0, 0, :, 16, 16].abs().square().numpy()
    near = np.arange(power.argmax() - 4, power.argmax() + 5)
    assert (power[near] * near).sum() / power[near].sum() == pytest.approx(at, abs=0.05)


def test_the_phasor_field_is_the_sum_of_waves_out_and_back() -> None:
    wall, time, depth_m = WallGrid(0.8, 0.6, 3, 4), TimeAxis(30, 100e-12, 200e-12), 0.31
    x = torch.rand(1, 1, 30, 3, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    field = ConfocalRsd(wall, time, np.array([depth_m]), 0.3, 4.0)(x)[0, 0, 0]
    per_m, sigma_m = frequencies_per_m(time, 0.3, 4.0), 4.0 * 0.3 / 6
    path_m = (time.start_s + (np.arange(30) + 0.5) * 100e-12) * SPEED_OF_LIGHT_M_PER_S
    weight = np.exp(-0.5 * (2 * np.pi * (per_m - 1 / 0.3) * sigma_m) ** 2)
    for row, col in ((0, 0), (1, 2), (2, 3)):
        across = (np.arange(4) - col) * 0.2, ((np.arange(3) - row) * 0.2)[:, None]
        away_m = np.sqrt(across[0] ** 2 + across[1] ** 2 + depth_m**2)
        total = 0j
        for one, share in zip(per_m, weight, strict=True):
            at_wall = np.tensordot(np.exp(-2j * np.pi * one * path_m), x[0, 0].numpy(), axes=1)
            total += share * (at_wall * np.exp(4j * np.pi * one * away_m) / away_m**2).sum()
        assert complex(field[row, col]) == pytest.approx(total, rel=1e-6)
    # Of a window as long as this the frequencies are so close that a pulse beside it does not come in again.
    assert 1 / np.diff(per_m).max() >= path_m[-1] - path_m[0] + 6 * sigma_m - 1e-9
    assert per_m[0] >= 1 / 0.3 - 3 / (2 * np.pi * sigma_m)
    assert per_m[-1] <= 1 / 0.3 + 3 / (2 * np.pi * sigma_m)
