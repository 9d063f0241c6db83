"""Gated windows: ambient light in the bins in which the gate was open, exactly 0 in the others, summed here."""

import numpy as np
import numpy.typing as npt
import pytest
import torch

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.gate import open_bins
from nlos.recon.layers.rates import rates_of
from nlos.recon.noise import estimate, without_background
from nlos.recon.reconstruct import reconstruct
from nlos.recon.without_torch import lct as plain

WALL, TIME = WallGrid(1.0, 1.0, 16, 16), TimeAxis(400, 40e-12)
BIN = np.arange(TIME.bins)
AMBIENT = 1.0
GATES = {
    "closes early": BIN < 240,
    "open for less than half": (BIN >= 80) & (BIN < 210),
    "shut in the middle": (BIN < 240) | (BIN >= 300),
    "shut after the direct light": (BIN < 12) | (BIN >= 70),
}


def light(half_m: float, z_m: float, exponent: float = 4.0) -> npt.NDArray[np.float64]:
    """(T, H, W): a square facing the wall, off its middle, summed point by point; 4 counts at the brightest."""
    x_m, y_m = np.meshgrid(WALL.x_m(), WALL.y_m())
    across_m = np.linspace(-half_m, half_m, 40)
    counts = np.zeros((TIME.bins, WALL.rows, WALL.cols))
    rows, cols = np.indices(x_m.shape)
    for to_m in across_m + 0.15:
        squared = (x_m - to_m) ** 2 + (y_m - 0.1 - across_m[:, None, None]) ** 2 + z_m**2
        arrived = (2 * np.sqrt(squared) / SPEED_OF_LIGHT_M_PER_S / TIME.bin_width_s).astype(int)
        np.add.at(counts, (arrived, *np.broadcast_arrays(rows, cols, arrived)[:2]), squared ** (-exponent / 2))
    return counts * (4 / counts.max())


def gated(name: str, seed: int = 0) -> npt.NDArray[np.float32]:
    rate = (light(0.15, 0.7) + AMBIENT) * GATES[name][:, None, None]
    return np.random.default_rng(seed).poisson(rate).astype(np.float32)


@pytest.mark.parametrize("name", GATES)
def test_the_background_of_a_gated_window_is_that_of_its_open_bins(name: str) -> None:
    counts = torch.from_numpy(gated(name))[None, None]
    bare = torch.from_numpy(light(0.15, 0.7).sum(axis=(1, 2)) == 0)
    opened = torch.from_numpy(GATES[name])
    noise = estimate(counts, None, TIME)
    assert float(noise.background) == pytest.approx(AMBIENT, rel=0.06)
    left = without_background(counts, noise)[0, 0].mean(dim=(1, 2))
    rates = rates_of(counts, None)
    assert float(rates.presence) == 1
    unit = float(counts.mean()) / float(rates.raw.mean())
    for each in (left, rates.net[0, 0].mean(dim=(1, 2)) * unit):
        assert abs(float(each[bare & opened].mean())) < 0.06 * AMBIENT
        assert float(each[~opened].abs().max()) == 0
    assert float(rates.background) * unit == pytest.approx(AMBIENT, rel=0.06)


@pytest.mark.parametrize("name", GATES)
def test_a_patch_is_where_it_is_in_a_gated_window(name: str) -> None:
    counts, even = gated(name), np.ones((WALL.rows, WALL.cols))
    made = reconstruct(Transient(counts, even, WALL, TIME), "lct", explain=False)
    row, col = np.unravel_index(made.albedo.argmax(), made.albedo.shape)
    assert abs(WALL.x_m()[col] - 0.15) < 0.15
    assert abs(WALL.y_m()[row] - 0.1) < 0.15
    assert made.depth_m[row, col] == pytest.approx(0.7, abs=0.02)
    settings = plain.Settings()
    alone = plain.build(settings, WALL, TIME)(counts, even)
    assert alone.depth_m[row, col] == pytest.approx(0.7, abs=0.02)


@pytest.mark.parametrize("counts_of_it", [None, 4, 400])
@pytest.mark.parametrize(
    ("half_m", "z_m", "exponent"), [(0.01, 0.7, 2.0), (0.01, 1.0, 4.0), (0.5, 0.8, 4.0), (0.15, 0.7, 4.0)]
)
def test_dark_bins_without_ambient_light_are_no_gate(
    half_m: float, z_m: float, exponent: float, counts_of_it: int | None
) -> None:
    """Nothing is subtracted from the light of points and planes, retroreflective ones among them, whose mean histograms
    are level."""
    rate = light(half_m, z_m, exponent)
    if counts_of_it is not None:
        rate = np.random.default_rng(1).poisson(rate * (counts_of_it / 4)).astype(np.float64)
    counts = rate.astype(np.float32)
    assert open_bins(counts.reshape(TIME.bins, -1)) is None
    assert float(estimate(torch.from_numpy(counts)[None, None], None, TIME).background) == 0


@pytest.mark.parametrize("name", ["closes early", "shut after the direct light"])
def test_a_gate_takes_nothing_from_what_a_picture_explains(name: str) -> None:
    even = np.ones((WALL.rows, WALL.cols))
    rate = light(0.15, 0.7) + AMBIENT
    always = np.random.default_rng(2).poisson(rate).astype(np.float32)
    shares = []
    for counts in (always, always * GATES[name][:, None, None]):
        made = reconstruct(Transient(counts.astype(np.float32), even, WALL, TIME), "lct")
        assert made.explained is not None
        assert made.explained.share is not None
        shares.append(made.explained.share)
    assert shares[1] > shares[0] - 0.1


def test_ambient_light_behind_a_gate_is_nothing_to_explain() -> None:
    counts = np.random.default_rng(3).poisson(np.ones((TIME.bins, 16, 16)) * GATES["closes early"][:, None, None])
    even = np.ones((WALL.rows, WALL.cols))
    made = reconstruct(Transient(counts.astype(np.float32), even, WALL, TIME), "lct")
    assert made.explained is not None
    assert made.explained.nothing
