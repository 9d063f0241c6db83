"""Below the light cone lies noise and nothing else: drawn noise of every kind, its variance known, over drawn light."""

import numpy as np
import numpy.typing as npt
import pytest
import torch

from nlos.recon.layers.any_noise import AGREE, unless_photons
from nlos.recon.layers.below_the_cone import Rest, below_the_cone, recorded

BINS, BIN_S, SIDE_M = 256, 64e-12, 2.0
PEAK = 40.0
Cube = npt.NDArray[np.float64]


def light(rows: int, cols: int, *, late_s: Cube | float = 0.0) -> Cube:
    """Three small surfaces at 0.6 to 1.2 m, confocal, a response of 90 ps, (T, H, W); mean peak `PEAK`."""
    y, x = ((np.arange(n) + 0.5) / n * SIDE_M - SIDE_M / 2 for n in (rows, cols))
    t = (np.arange(BINS) + 0.5)[:, None, None] * BIN_S
    total = np.zeros((BINS, rows, cols))
    for across, up, deep, albedo in ((0.3, 0.2, 0.6, 0.2), (-0.5, 0.1, 0.9, 1.0), (0.1, -0.6, 1.2, 2.0)):
        r = np.sqrt((x[None] - across) ** 2 + (y[:, None] - up) ** 2 + deep**2)
        total += albedo / r**4 * np.exp(-0.5 * ((t - 2 * r / 299792458.0 - late_s) / 90e-12) ** 2)
    return total * PEAK / total.max(axis=0).mean()


def drawn(kind: str, clean: Cube, rng: np.random.Generator) -> tuple[Cube, float]:
    """Rates, and the mean variance of a bin."""
    if kind == "photons":
        return rng.poisson(clean + 0.3).astype(float), float((clean + 0.3).mean())
    if kind == "uniform":
        return clean + 9.0 * rng.random(clean.shape), 81 / 12
    return clean * (1 + 0.15 * rng.standard_normal(clean.shape)), float(np.square(0.15 * clean).mean())


def rest_of(rates: Cube, measured: npt.NDArray[np.bool_] | None = None) -> Rest | None:
    seen = np.ones(rates.shape[1:], bool) if measured is None else measured
    cube = torch.from_numpy((rates * seen).astype(np.float32))
    return below_the_cone(cube, torch.from_numpy(seen), (SIDE_M, SIDE_M * rates.shape[2] / rates.shape[1]), BIN_S)


@pytest.mark.parametrize("kind", ["photons", "uniform", "grain"])
@pytest.mark.parametrize(("rows", "cols"), [(64, 64), (32, 48)])
def test_drawn_noise_of_every_kind_is_found_to_a_few_hundredths_of_a_decade(kind: str, rows: int, cols: int) -> None:
    rates, variance = drawn(kind, light(rows, cols), np.random.default_rng(3))
    rest = rest_of(rates)
    assert rest is not None
    own = {"photons": 1.0, "uniform": rest.even, "grain": rest.bright}[kind]
    assert abs(0.5 * np.log10(rest.variance * own / variance)) < 0.03


def test_light_alone_leaves_next_to_nothing() -> None:
    clean = light(64, 64)
    rest = rest_of(clean)
    assert rest is not None
    assert rest.variance < 1e-4 * clean.mean()


@pytest.mark.parametrize("regular", [True, False])
def test_noise_is_found_on_a_part_of_the_points(regular: bool) -> None:
    rng = np.random.default_rng(5)
    rates, variance = drawn("photons", light(64, 64), rng)
    measured = np.zeros((64, 64), bool)
    if regular:
        measured[1::2, ::2] = True
    else:
        measured.ravel()[rng.choice(4096, 900, replace=False)] = True
    rest = rest_of(rates, measured)
    assert rest is not None
    assert abs(0.5 * np.log10(rest.variance / variance)) < 0.05


def test_clocks_that_are_off_and_backgrounds_that_differ_from_point_to_point_are_no_noise() -> None:
    rng = np.random.default_rng(7)
    clean = light(64, 64, late_s=rng.normal(0, 15e-12, (64, 64)))
    ambient = rng.uniform(0, 3, (64, 64))
    rates = rng.poisson(20 * clean + ambient).astype(float)
    rest = rest_of(rates)
    assert rest is not None
    assert abs(0.5 * np.log10(rest.variance / (20 * clean + ambient).mean())) < 0.05
    assert rest.least > 1.15 * rest.variance  # what the delays would have passed for


def test_the_estimate_knows_no_unit() -> None:
    rates, _ = drawn("photons", light(32, 32), np.random.default_rng(1))
    one, other = rest_of(rates), rest_of(1e-3 * rates)
    assert one is not None
    assert other is not None
    assert other.variance == pytest.approx(1e-6 * one.variance, rel=1e-3)


@pytest.mark.parametrize(("points", "bins"), [(4, 256), (32, 12)])
def test_too_few_points_or_bins_tell_nothing(points: int, bins: int) -> None:
    rates = np.random.default_rng(0).poisson(3.0, (bins, points, points)).astype(float)
    assert rest_of(rates) is None
    assert rest_of(0 * rates) is None


def test_what_was_cut_is_left_out_and_what_is_dark_is_not() -> None:
    profile = torch.zeros(100)
    profile[20:80] = torch.hann_window(60)
    assert recorded(profile) == (0, 100)  # dark before and behind: no background
    cut = 5.0 + profile
    cut[:30], cut[90:] = 0, 0
    assert recorded(cut) == (30, 90)


def test_photon_statistics_stand_where_the_other_agrees_or_is_unknown_and_give_way_continuously() -> None:
    photons = torch.full((5,), -1.0)
    other = photons + torch.tensor([0.9 * AGREE, torch.nan, 1.5 * AGREE, 3 * AGREE, -3 * AGREE])
    expected = torch.tensor([-1.0, -1.0, -1.0 + 0.75 * AGREE, -1.0 + 3 * AGREE, -1.0 - 3 * AGREE])
    torch.testing.assert_close(unless_photons(photons, other), expected)
