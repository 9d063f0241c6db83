"""A surface far behind a near one sends a thousandth of its light: it is looked for all the same. Light summed here."""

import numpy as np
import numpy.typing as npt
import pytest
import torch

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.rates import lit_bins, rates_of
from nlos.recon.reconstruct import reconstruct

TIME = TimeAxis(400, 40e-12)
BIN_M = TIME.bin_width_s * SPEED_OF_LIGHT_M_PER_S / 2
NEAR, FAR = (-0.25, 0.2, 0.25), (0.2, -0.15, 1.3)
AMBIENT = 0.01


def light(wall: WallGrid, *middles_m: tuple[float, float, float]) -> npt.NDArray[np.float64]:
    """(T, H, W) of Lambertian squares of 0.3 m that face the wall, summed over their points."""
    x_m, y_m = np.meshgrid(wall.x_m(), wall.y_m())
    across_m = (np.arange(30) - 14.5) * 0.01
    counts = np.zeros((TIME.bins, wall.rows * wall.cols))
    for middle_x_m, middle_y_m, z_m in middles_m:
        for to_m in across_m:
            aside, above = x_m - middle_x_m - to_m, y_m - middle_y_m - across_m[:, None, None]
            squared = aside**2 + above**2 + z_m**2
            arrived = (np.sqrt(squared) / BIN_M).astype(int)
            point = np.broadcast_to(np.arange(counts.shape[1]).reshape(x_m.shape), arrived.shape)
            np.add.at(counts, (arrived, point), z_m**2 / squared**3)
    return counts.reshape(TIME.bins, wall.rows, wall.cols)


def scan(points: int, peak: float, *middles_m: tuple[float, float, float]) -> Transient:
    wall = WallGrid(1.0, 1.0, points, points)
    rate = light(wall, *middles_m)
    counts = np.random.default_rng(points).poisson(rate * (peak / rate.max()) + AMBIENT)
    return Transient(counts.astype(np.float32), np.ones((points, points)), wall, TIME)


def ends_m(made: Transient) -> float:
    """Depth at which NANO is told that light ends."""
    return lit_bins(rates_of(torch.from_numpy(made.counts)[None, None], None).net)[1] * BIN_M


@pytest.mark.parametrize(("points", "peak"), [(24, 20000), (24, 200), (8, 2000), (5, 2000)])
def test_light_ends_behind_the_farthest_surface_that_stands_out(points: int, peak: float) -> None:
    assert ends_m(scan(points, peak, NEAR, FAR)) > FAR[2]
    assert ends_m(scan(points, peak, NEAR)) < 1.05  # no farther than the near one's light to the wall's far corner


def test_a_far_surface_behind_a_bright_near_one_is_seen_and_within_its_intervals() -> None:
    made = reconstruct(scan(12, 20000, NEAR, FAR), "nano", explain=False)
    there = np.s_[6:9, 7:10]  # pixels that it fills
    assert np.nanmedian(made.depth_m[there]) == pytest.approx(FAR[2], abs=0.03)
    assert made.intervals is not None
    assert np.median(made.intervals.seen[there]) > 0.5
    assert np.median(made.intervals.albedo_high[there]) > 0.5 * float(made.albedo.max())


def test_how_far_intervals_reach_is_known() -> None:
    """Five photons of a far surface among nine of ambient light are no sign of it."""
    to_m = reconstruct(scan(5, 90, NEAR), "nano", explain=False).intervals_to_m()
    assert to_m is not None
    assert 0.7 < to_m < 1.3
