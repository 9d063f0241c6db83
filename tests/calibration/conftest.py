"""A raw scan made here, with known constants: independent of the simulated bench and of the code under test."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

C = 299_792_458.0


@dataclass(frozen=True)
class RawScan:
    expected: npt.NDArray[np.float64]  # (N, T)
    counts: npt.NDArray[np.uint32]  # (N, T), a Poisson draw
    x_m: npt.NDArray[np.float64]
    y_m: npt.NDArray[np.float64]
    arrival_bins: npt.NDArray[np.float64]
    hidden: npt.NDArray[np.float64]  # (N, T), the hidden object's share of `expected`
    bin_width_s: float
    scanner_m: tuple[float, float, float]
    delay_s: float


def make_raw_scan(
    side: int = 16,
    wall_m: float = 2.0,
    bins: int = 512,
    bin_width_s: float = 32e-12,
    scanner_m: tuple[float, float, float] = (0.1, -0.2, 2.0),
    delay_s: float = -11e-9,
    direct_counts: float = 2000.0,
    tail_share: float = 0.05,
    background: float = 0.2,
    fwhm_s: float = 70e-12,
    depth_m: float = 0.9,
    hidden_counts: float = 40.0,
    seed: int = 3,
    later_s: npt.NDArray[np.float64] | float = 0.0,
) -> RawScan:
    """A Gaussian pulse with an exponential tail from every wall point, a point object behind the corner, and noise; all
    light of a point `later_s` later."""
    random = np.random.default_rng(seed)
    grid = ((np.arange(side) + 0.5) / side - 0.5) * wall_m
    x, y = (a.ravel() for a in np.meshgrid(grid, -grid))
    sx, sy, sz = scanner_m
    arrival_s = delay_s + 2 * np.sqrt((x - sx) ** 2 + (y - sy) ** 2 + sz**2) / C + later_s
    return_s = 2 * np.sqrt((x - 0.2) ** 2 + y**2 + depth_m**2) / C
    fine = 8
    edges = np.arange(bins * fine + 1) / fine * bin_width_s
    middle = (edges[1:] + edges[:-1]) / 2
    sigma, decay = fwhm_s / 2.3548, 250e-12

    def pulse(at: float) -> npt.NDArray[np.float64]:
        t = middle - at
        main = np.exp(-0.5 * (t / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
        tail = np.where(t > 0, np.exp(-np.maximum(t, 0) / decay) / decay, 0)
        density = (1 - tail_share) * main + tail_share * tail
        return density.reshape(bins, fine).mean(axis=1) * bin_width_s

    albedo = 0.6 + 0.4 * random.random(len(x))
    direct = np.array([a * direct_counts * pulse(t) for a, t in zip(albedo, arrival_s, strict=True)])
    hidden = np.array([a * hidden_counts * pulse(t + r) for a, t, r in zip(albedo, arrival_s, return_s, strict=True)])
    expected = direct + hidden + background
    counts = random.poisson(expected).astype(np.uint32)
    return RawScan(expected, counts, x, y, arrival_s / bin_width_s, hidden, bin_width_s, scanner_m, delay_s)


@pytest.fixture(scope="session")
def raw_scan() -> RawScan:
    return make_raw_scan()
