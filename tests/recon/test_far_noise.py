"""A time axis that continues after the light has ended changes no picture: noise from far away is not made bright."""

from dataclasses import replace

import numpy as np
import pytest

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.noise import last_lit_bin
from nlos.recon.reconstruct import reconstruct

WALL, BIN_S, BINS = WallGrid(1.0, 1.0, 32, 32), 32e-12, 256
BACKGROUND, RNG_SEED = 0.05, 3


def scan(peak: float) -> Transient:
    """Two diffuse patches, 0.5 and 0.8 m behind the wall: photons drawn over a flat background."""
    x, y = np.meshgrid(WALL.x_m(), WALL.y_m())
    rates = np.zeros((BINS, 32, 32))
    for px, py, depth, size in ((-0.2, 0.15, 0.5, 0.12), (0.2, -0.15, 0.8, 0.16)):
        for dx in np.linspace(-size, size, 9):
            for dy in np.linspace(-size, size, 9):
                distance = np.sqrt((x - px - dx) ** 2 + (y - py - dy) ** 2 + depth**2)
                bins = np.minimum((2 * distance / SPEED_OF_LIGHT_M_PER_S / BIN_S).astype(int), BINS - 1)
                np.add.at(rates, (bins, *np.indices(bins.shape)), distance**-4)
    rates *= peak / np.quantile(rates.max(axis=0), 0.5)
    counts = np.random.default_rng(RNG_SEED).poisson(rates + BACKGROUND).astype(np.float32)
    return Transient(counts, np.ones((32, 32)), WALL, TimeAxis(BINS, BIN_S))


def longer(transient: Transient, times: int) -> Transient:
    """The same scan with a time axis so many times as long, dark counts alone in what is added."""
    rng = np.random.default_rng(RNG_SEED + 1)
    dark = rng.poisson(BACKGROUND, ((times - 1) * BINS, 32, 32)).astype(np.float32)
    counts = np.concatenate([transient.counts, dark])
    return replace(transient, counts=counts, time=TimeAxis(times * BINS, BIN_S))


@pytest.mark.parametrize("method", ["lct", "fk"])
@pytest.mark.parametrize("peak", [20.0, 3.0])
def test_a_longer_time_axis_shows_the_same_picture(method: str, peak: float) -> None:
    short = scan(peak)
    seen, from_longer = (reconstruct(one, method).albedo for one in (short, longer(short, 6)))
    assert np.corrcoef(seen.ravel(), from_longer.ravel())[0, 1] >= 0.95


def test_light_ends_where_it_stands_out_of_its_noise_for_the_last_time() -> None:
    rng = np.random.default_rng(0)
    dark = rng.normal(0.0, 1.0, 1024)
    assert last_lit_bin(dark) == 1024
    lit = dark.copy()
    lit[100:200] += 3.0
    lit[600:604] += 20.0
    assert 604 <= last_lit_bin(lit) <= 603 + 64
    assert last_lit_bin(lit[:40]) == 40
