"""What lies below the light cone is noise: its variance comes out whatever the scene and the kind of noise."""

import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from studies.evanescent_noise import noise_variance

WALL, TIME = WallGrid(2.0, 2.0, 48, 48), TimeAxis(160, 100e-12)
PITCH_M = (2.0 / 48, 2.0 / 48)


def light() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Light of a few points at different depths, 1 / r^4."""
    total = np.zeros((TIME.bins, 48, 48))
    for x, y, z in ((0.2, -0.3, 0.7), (-0.5, 0.1, 1.0), (0.4, 0.5, 1.3), (0.0, 0.0, 0.9)):
        r = np.sqrt((WALL.x_m() - x) ** 2 + (WALL.y_m()[:, None] - y) ** 2 + z**2)
        arrival = 2 * r / 299792458.0 / TIME.bin_width_s
        total += np.exp(-0.5 * ((np.arange(TIME.bins)[:, None, None] - arrival) / 1.2) ** 2) / r**4
    return np.asarray(total / total.max())


@pytest.mark.parametrize("bright", [0.0, 1.0, 100.0])
def test_flat_noise_has_its_own_variance_however_bright_the_scene(bright: float) -> None:
    noise = np.random.default_rng(1).normal(0, 0.2, (TIME.bins, 48, 48))
    assert noise_variance(bright * light() + noise, PITCH_M, TIME.bin_width_s, 0) == pytest.approx(0.04, rel=0.1)


def test_photons_and_grain_have_the_mean_of_their_variances() -> None:
    rng = np.random.default_rng(2)
    rate = 30 * light() + 0.5
    assert noise_variance(rng.poisson(rate), PITCH_M, TIME.bin_width_s, 1) == pytest.approx(rate.mean(), rel=0.15)
    grain = 0.1 * rate
    grainy = rate + grain * rng.standard_normal(rate.shape)
    assert noise_variance(grainy, PITCH_M, TIME.bin_width_s, 2) == pytest.approx(np.square(grain).mean(), rel=0.25)


def test_light_alone_has_next_to_none() -> None:
    scene = light()
    assert noise_variance(scene, PITCH_M, TIME.bin_width_s, 0) < 1e-5 * np.square(scene).mean()


def test_a_grid_too_coarse_to_tell_is_refused() -> None:
    with pytest.raises(ValueError, match="no evanescent"):
        noise_variance(np.ones((8, 4, 4)), (0.5, 0.5), 1e-9, 0)
