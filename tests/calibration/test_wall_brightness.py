"""Walls that are not as bright everywhere, lit by surfaces summed element by element."""

import logging

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S as C
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.correct import correct_points
from nlos.calibration.raw_points import RawPoints

SIDE, BINS, WIDTH_S, DIRECT, HIDDEN = 20, 512, 32e-12, 4000, 600
SCANNER_M = np.array([0.1, -0.2, 1.4])
Floats = npt.NDArray[np.float64]
AT = (np.arange(SIDE) + 0.5) / SIDE * 1.2 - 0.6
X, Y = (each.ravel() for each in np.meshgrid(AT, AT[::-1]))
TILES = np.where((np.floor(X / 0.15) + np.floor(Y / 0.15)) % 2 > 0, 1.0, 0.4)
HALF = np.where(X > 0, 1.0, 0.1)
LINES = np.repeat(np.random.default_rng(1).uniform(0.2, 1.8, SIDE), SIDE)
HIGHLIGHT = 1 + 8 * np.exp(-((X - 0.1) ** 2 + (Y + 0.2) ** 2) / 0.25**2)


def scan(of_direct: Floats, of_hidden: Floats) -> RawPoints:
    """A panel of 0.6 m, 0.7 m before the wall, aside of its middle; light of each point times these factors (N,)."""
    random = np.random.default_rng(2)
    panel = random.uniform([-0.1, -0.4, 0.7], [0.5, 0.2, 0.7], (4000, 3))
    counts = np.zeros((len(X), BINS), np.uint32)
    for point, place in enumerate(np.stack([X, Y, 0 * X], axis=1)):
        off_m, way_m = np.linalg.norm(SCANNER_M - place), np.linalg.norm(panel - place, axis=1)
        fades = (1.4 / off_m) ** 2
        direct = random.poisson(DIRECT * of_direct[point] * fades)
        back = panel[:, 2] ** 4 / way_m**8  # cosines at wall and panel, both ways
        seen = random.random(4000) < back * of_hidden[point] * fades * HIDDEN / 4000 * 0.7**4
        times = 2 * (off_m + np.concatenate([np.zeros(direct), way_m[seen]])) / C - 8e-9
        bins = np.floor((times + random.normal(0, 25e-12, len(times))) / WIDTH_S).astype(int)
        counts[point] = np.bincount(bins[(bins >= 0) & (bins < BINS)], minlength=BINS)
    nothing = np.zeros(len(X))
    return RawPoints(counts + random.poisson(0.05, counts.shape), X, Y, nothing + 1, nothing, nothing,
                     TimeAxis(BINS, WIDTH_S))  # fmt: skip


def test_hidden_light_of_a_wall_of_tiles_is_as_of_an_even_wall(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        done = correct_points(scan(TILES, TILES**2))
    assert "hidden light follows its square" in caplog.text
    assert done.exposure_s / np.median(done.exposure_s) == pytest.approx(TILES**2 / np.median(TILES**2), rel=0.35)


def test_of_little_direct_light_it_is_told_how_hidden_light_follows(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        correct_points(scan(0.02 * TILES, TILES**2))
    assert "hidden light follows its square" in caplog.text


def test_one_edge_between_bright_and_dark_is_enough_of_few_photons(caplog: pytest.LogCaptureFixture) -> None:
    step = np.where(X > 0, 1.0, 0.3)
    with caplog.at_level(logging.WARNING):
        done = correct_points(scan(0.2 * step, 0.2 * step**2))
    assert "hidden light follows its square" in caplog.text
    assert done.light is not None
    assert np.std(np.log(done.light / step**2)) < 0.25


def test_single_frames_are_evened_as_their_whole_scan_is() -> None:
    raw = scan(TILES, TILES**2)
    whole = correct_points(raw)
    assert whole.offsets is not None
    assert whole.light is not None
    frame = correct_points(raw, known=whole.known(whole.offsets.offset_bins))
    np.testing.assert_array_equal(frame.exposure_s, whole.exposure_s)


def test_points_of_a_wall_too_dark_to_add_anything_count_as_not_measured(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        done = correct_points(scan(HALF, HALF**2))
    assert f"{SIDE * SIDE // 2} of {SIDE * SIDE} points are too dark" in caplog.text
    np.testing.assert_array_equal(done.exposure_s > 0, X > 0)


def test_light_that_differs_from_line_to_line_is_undone_once(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        done = correct_points(scan(LINES, LINES))
    assert "hidden light follows it: laser or dwell differ" in caplog.text
    assert done.exposure_s / np.median(done.exposure_s) == pytest.approx(LINES / np.median(LINES), rel=0.35)
    assert np.median(done.exposure_s) == pytest.approx(1.0, rel=0.02)  # as long as they were, in the middle
    words = caplog.text.split()
    brightest, darkest = np.quantile(LINES, [0.9, 0.1])
    assert float(words[words.index("times") - 1]) == pytest.approx(brightest / darkest, rel=0.05)


@pytest.mark.parametrize("of_direct", [np.ones(len(X)), HIGHLIGHT, TILES], ids=["even", "highlight", "tiles"])
def test_hidden_light_that_does_not_follow_direct_light_is_as_it_was(
    of_direct: Floats, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        done = correct_points(scan(of_direct, np.ones(len(X))))
    assert "follows" not in caplog.text
    np.testing.assert_array_equal(done.exposure_s, 1.0)
