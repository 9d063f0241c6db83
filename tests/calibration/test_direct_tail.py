"""A tail of direct light that was left behind the owner's cut is noticed; a scene's own light is not taken for one."""

import numpy as np
import numpy.typing as npt
import pytest

from nlos.calibration.direct_tail import bins_of_tail

BINS, WIDTH_S, CUT = 2048, 4e-12, 600
BIN = np.arange(BINS)
Counts = npt.NDArray[np.float64]


def all_points(tail: float, ambient: float = 2700.0, scene_at: int = 900, seed: int = 0) -> Counts:
    """Light of all points of a scan together: what is left of the pulse, a hidden scene, ambient light; cut."""
    scene = 11000 * np.exp(-(((BIN - scene_at) / np.where(scene_at > BIN, 30, 110)) ** 2))
    counts = np.random.default_rng(seed).poisson(ambient + scene + tail * np.exp(-(BIN - CUT) / 110))
    counts[:CUT] = 0
    return counts.astype(float)


@pytest.mark.parametrize("cut", [CUT, 0])
def test_a_tail_is_cut_where_it_has_faded(cut: int) -> None:
    for seed in range(5):
        bins = bins_of_tail(all_points(7000, seed=seed), cut, WIDTH_S)
        assert bins is not None
        assert CUT + 100 < bins < 900 - 60


@pytest.mark.parametrize("cut", [CUT, 0])
@pytest.mark.parametrize("tail", [0, 200, 1000])
def test_little_or_nothing_of_it_is_no_tail(cut: int, tail: float) -> None:
    assert bins_of_tail(all_points(tail), cut, WIDTH_S) is None


def test_a_scene_that_begins_at_once_is_none() -> None:
    """A board parallel to the wall, another behind it, no ambient light and nothing cut off."""
    near, far = (np.where(at < BIN, (at / (BIN + 1.0)) ** 6, 0) for at in (700, 1300))
    boards = 9000 * near + 7000 * far
    assert bins_of_tail(boards, 0, WIDTH_S) is None
    assert bins_of_tail(boards[650:], 0, WIDTH_S) is None
    assert bins_of_tail(np.zeros(BINS), CUT, WIDTH_S) is None
    assert bins_of_tail(all_points(7000)[:620], CUT, WIDTH_S) is None
