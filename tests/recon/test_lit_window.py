"""A window that is much longer than the light in it: pictures by the light cone are as deep as in a short one."""

from dataclasses import replace

import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.lit_window import is_dark, lit_window
from nlos.recon.live import LiveReconstruction
from nlos.recon.over_time.half_grid import HalfGrid
from nlos.recon.reconstruct import get_ready, reconstruct
from nlos.recon.with_torch import built

POINTS, SIDE_M, LIGHT_M_PER_S = 24, 0.6, 299_792_458.0
PLACES_M = (np.arange(POINTS) + 0.5) / POINTS * SIDE_M - SIDE_M / 2


def drawn(depth_m: float, bins: int, bin_s: float, photons: float = 60_000.0, dark: float = 0.0) -> Transient:
    """Photons by way of a plate of 12 x 12 cm aside of the wall's middle, light paths one by one; `dark` a bin."""
    rates = np.zeros((bins, POINTS, POINTS))
    rows, cols = np.mgrid[:POINTS, :POINTS]
    for x, y in np.stack(np.meshgrid(*[np.linspace(0.02, 0.14, 9)] * 2), -1).reshape(-1, 2):
        away = np.sqrt((PLACES_M[None] - x) ** 2 + (-PLACES_M[:, None] - y) ** 2 + depth_m**2)
        at = np.floor(2 * away / LIGHT_M_PER_S / bin_s).astype(int)
        np.add.at(rates, (at, rows, cols), depth_m**2 / away**6)
    rates *= photons / rates.sum()
    counts = np.random.default_rng(0).poisson(rates + dark).astype(np.float32)
    return Transient(counts, np.ones((POINTS, POINTS)), WallGrid(SIDE_M, SIDE_M, POINTS, POINTS), TimeAxis(bins, bin_s))


@pytest.mark.parametrize("method", ["lct", "gram", "backprojection"])
@pytest.mark.parametrize("dark", [0.0, 0.01])
@pytest.mark.parametrize(("bins", "bin_s"), [(1024, 64e-12), (2048, 32e-12)])
def test_a_whole_laser_period_is_as_deep_as_a_short_window(bins: int, bin_s: float, dark: float, method: str) -> None:
    picture = reconstruct(drawn(0.45, bins, bin_s, dark=dark), method, explain=False)
    bright = picture.albedo > 0.5 * picture.albedo.max()
    assert np.nanmedian(picture.depth_m[bright]) == pytest.approx(0.45, abs=0.015)
    assert picture.volume is not None
    assert picture.volume.albedo.shape[0] == picture.volume.depths_m.size == bins
    assert picture.volume.depths_m[-1] == pytest.approx((bins - 0.5) * bin_s * LIGHT_M_PER_S / 2)


def test_what_is_far_behind_is_kept() -> None:
    near, far = drawn(0.45, 2048, 32e-12, dark=0.01), drawn(6.0, 2048, 32e-12, photons=3000.0)
    both = Transient(near.counts + far.counts, near.exposure_s, near.wall, near.time)
    just_before_half = drawn(4.4, 2048, 32e-12, photons=3000.0)
    assert lit_window(near).time.bins == 512
    assert lit_window(replace(near, counts=near.counts + just_before_half.counts)).time.bins == 2048
    assert lit_window(both).time.bins == 2048
    assert lit_window(far).time.bins == 2048


@pytest.mark.parametrize(("farthest_m", "bins"), [(0.0, 512), (2.4, 512), (2.5, 1024), (6.0, 2048), (50.0, 2048)])
def test_depths_that_are_asked_for_are_looked_at(farthest_m: float, bins: int) -> None:
    assert lit_window(drawn(0.45, 2048, 32e-12, dark=0.01), farthest_m).time.bins == bins


@pytest.mark.parametrize("farthest_m", [0.0, 2.4])
def test_a_record_that_begins_late_is_cut_by_its_own_times(farthest_m: float) -> None:
    """64 bins of a record are not in it: where 2.4 m are, bin 500 of the whole one, is bin 436."""
    whole = drawn(0.45, 2048, 32e-12, dark=0.01)
    late = Transient(whole.counts[64:], whole.exposure_s, whole.wall, TimeAxis(1984, 32e-12, 64 * 32e-12))
    assert lit_window(late, farthest_m).time == TimeAxis(496, 32e-12, 64 * 32e-12)


@pytest.mark.parametrize(("length", "excess"), [(4, 3.2), (64, 0.8)])
def test_a_bright_stretch_stands_out_of_noise_and_a_long_one_may_be_fainter(length: int, excess: float) -> None:
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0.0, 1.0, 1024)
        assert is_dark(noise)
        noise[700 : 700 + length] = excess + 0.1 * noise[700 : 700 + length]
        assert not is_dark(noise)


def test_light_that_stands_out_nowhere_may_be_anywhere() -> None:
    faint = drawn(0.45, 2048, 32e-12, photons=30.0, dark=0.05)
    assert lit_window(faint) is faint


def test_points_that_were_not_measured_say_nothing() -> None:
    scan = drawn(0.45, 1024, 64e-12)
    counts, exposure_s = scan.counts.copy(), scan.exposure_s.copy()
    counts[900, 3, 4], exposure_s[3, 4] = 1e6, 0.0
    assert lit_window(Transient(counts, exposure_s, scan.wall, scan.time)).time.bins == lit_window(scan).time.bins


def test_what_is_built_beforehand_is_for_the_window_that_is_looked_at() -> None:
    built.cache_clear()
    scan = drawn(0.45, 2048, 32e-12)
    get_ready(scan, "lct")
    assert built.cache_info().misses == 1
    reconstruct(scan, "lct", explain=False)
    assert built.cache_info().misses == 1


@pytest.mark.parametrize("photons", [60_000.0, 600.0])
@pytest.mark.parametrize("method", ["nano", "lct"])
@pytest.mark.parametrize("hurried", [False, True])
def test_a_films_frame_of_a_whole_laser_period_is_as_deep(method: str, photons: float, hurried: bool) -> None:
    light = drawn(0.45, 2048, 32e-12, photons=photons, dark=photons / 1e7)
    made = LiveReconstruction(method).made_of_film(HalfGrid(light, light.wall), hurried=hurried)
    bright = made.albedo > 0.5 * made.albedo.max()
    assert np.nanmedian(made.depth_m[bright]) == pytest.approx(0.45, abs=0.015)
