"""The phasor field's wave is one that the instrument's response leaves standing, and that the time axis holds."""

import numpy as np
import pytest
import torch

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import InvalidSettings
from nlos.recon.methods.phasor import KEPT, Camera, Settings, build

WALL, TIME = WallGrid(0.4, 0.4, 8, 8), TimeAxis(64, 100e-12)
BIN_M = SPEED_OF_LIGHT_M_PER_S * TIME.bin_width_s
PIXELS_M, LONGEST_M = 4 * 0.4 / 8, 64 * BIN_M / 4
"""Four wall pixels; four cycles fill the time axis."""


def wave_m(bins: int) -> float:
    """Of which pictures are made where an instant comes out as an even light of so many bins."""
    camera = build(Settings(planes=4), WALL, TIME)
    assert isinstance(camera, Camera)
    counts = torch.ones(1, 1, TIME.bins, WALL.rows, WALL.cols)
    camera.volume(counts, response=torch.full((1, bins), 1 / bins))
    return camera.wavelength_m if camera.slower is None else camera.slower[0]


def test_an_instants_response_leaves_the_wave_as_it_is() -> None:
    assert wave_m(1) == pytest.approx(PIXELS_M)


def test_a_slower_instrument_has_the_shortest_wave_that_it_leaves_standing() -> None:
    chosen_m = wave_m(8)
    assert PIXELS_M < chosen_m < LONGEST_M
    left = [abs(np.sinc(8 * BIN_M / each) / np.sinc(BIN_M / each)) for each in (chosen_m, 0.97 * chosen_m)]
    assert left[1] < KEPT <= left[0]


def test_where_no_wave_that_fits_is_left_standing_it_is_the_longest_that_fits() -> None:
    assert wave_m(63) == pytest.approx(LONGEST_M)


def test_more_planes_are_closer_together_but_not_closer_to_the_wall() -> None:
    """A plane a few millimetres off shows the light of the one point before it, brighter than any scene."""
    time = TimeAxis(512, 100e-12)
    cameras = [build(Settings(planes=planes), WALL, time) for planes in (128, 512)]
    assert all(isinstance(each, Camera) for each in cameras)
    assert [each.depths_m[0] for each in cameras] == [pytest.approx(cameras[0].depths_m[-1] / 128)] * 2  # type: ignore[index]


def test_planes_are_not_asked_of_where_there_are_none() -> None:
    with pytest.raises(ValueError, match=r"near_m and far_m: planes of the exact .* with --depth-m NEAR:FAR"):
        Settings(variant="light_cone", near_m=0.5, far_m=2.0)
    with pytest.raises(InvalidSettings, match=r"far_m is 9 m, but light is looked at to .* add --depth-m :9"):
        build(Settings(far_m=9), WALL, TimeAxis(512, 100e-12))
