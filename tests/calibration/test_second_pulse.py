"""A laser that pulses twice, photon by photon, beside hidden surfaces that come nearly as one pulse to every point."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S as C
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.background import Background
from nlos.calibration.correct import CorrectedPoints, correct_points
from nlos.calibration.impulse_response import from_histogram
from nlos.calibration.known_direct import KnownDirect
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.second_pulse import SecondPulse
from nlos.calibration.without_second_pulses import without_second_pulses

SIDE, BINS, WIDTH_S, DIRECT, HIDDEN = 14, 900, 32e-12, 2000, 300
SCANNER_M = np.array([0.25, 0.1, 2.0])


def scan(wall_m: float, patch_m: tuple[float, float], *pulses: tuple[float, float]) -> RawPoints:
    """A square wall, a square patch before it at `patch_m` (depth, side), and of every photon for each of `pulses`
    (seconds, share) a share more, so many seconds later; 80 ps FWHM."""
    random = np.random.default_rng(3)
    at = (np.arange(SIDE) + 0.5) / SIDE * wall_m - wall_m / 2
    x, y = (each.ravel() for each in np.meshgrid(at, at[::-1]))
    wall = np.stack([x, y, 0 * x], axis=1)
    counts = np.zeros((len(x), BINS), np.uint32)
    for point, place in enumerate(wall):
        seen, direct = random.poisson([HIDDEN, DIRECT * (0.5 + random.random())])
        hit = np.stack([*random.uniform(-0.5, 0.5, (2, seen)) * patch_m[1], np.full(seen, patch_m[0])], axis=1)
        way_m = np.concatenate([np.zeros(direct), np.linalg.norm(hit - place, axis=1)])
        times = 3e-9 + 2 * (np.linalg.norm(SCANNER_M - place) + way_m) / C
        again = [times[random.random(len(times)) < share] + lag_s for lag_s, share in pulses]
        times = np.concatenate([times, *again])
        bins = np.floor((times + random.normal(0, 34e-12, len(times))) / WIDTH_S).astype(int)
        counts[point] = np.bincount(bins[bins < BINS], minlength=BINS) + random.poisson(0.02, BINS)
    nothing = np.zeros(len(x))
    return RawPoints(counts, x, y, nothing + 1, nothing, nothing, TimeAxis(BINS, WIDTH_S))


@pytest.mark.parametrize(("lag_ns", "percent"), [(1.0, 10), (2.0, 1), (5.0, 20)])
def test_a_second_pulse_is_told_with_its_lag_and_its_brightness(
    lag_ns: float, percent: float, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        correct_points(scan(1.0, (0.7, 0.3), (lag_ns * 1e-9, percent / 100)))
    assert "pulses twice" in caplog.text
    words = caplog.text.split()
    assert float(words[words.index("comes") + 1]) == pytest.approx(lag_ns, abs=0.02)
    assert float(words[words.index("%") - 1]) == pytest.approx(percent, rel=0.07)


def test_what_a_few_points_see_is_no_second_pulse(caplog: pytest.LogCaptureFixture) -> None:
    raw = scan(1.0, (0.7, 0.01), (0.0, 0.0))
    with caplog.at_level(logging.WARNING):
        correct_points(raw.select(slice(SIDE // 2 * (SIDE + 1), SIDE // 2 * (SIDE + 1) + 1)))
    assert "second pulse" not in caplog.text


@pytest.mark.parametrize(
    ("wall_m", "patch_m"),
    [(1.0, (0.7, 0.3)), (1.0, (0.3, 1.2)), (0.3, (1.0, 0.1)), (0.3, (0.8, 0.2)), (0.3, (1.5, 0.4))],
)
def test_a_surface_is_no_second_pulse_however_far_or_even_it_is(
    wall_m: float, patch_m: tuple[float, float], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        correct_points(scan(wall_m, patch_m, (0.0, 0.0)))
    assert "second pulse" not in caplog.text


@pytest.mark.parametrize(("wall_m", "patch_m", "share"), [(0.5, (0.63, 0.42), 0.05), (0.3, (0.5, 1.0), 0.2)])
def test_the_near_edge_of_a_large_surface_after_darkness_is_no_second_pulse(
    wall_m: float, patch_m: tuple[float, float], share: float, caplog: pytest.LogCaptureFixture
) -> None:
    """Of few photons: before the edge, where nothing came, a curve that dips below nothing had a pulse filled in."""
    few = scan(wall_m, patch_m, (0.0, 0.0))
    few = replace(few, counts=np.random.default_rng(0).binomial(few.counts, share).astype(np.uint32))
    with caplog.at_level(logging.WARNING):
        correct_points(few)
    assert "second pulse" not in caplog.text


def test_light_that_little_more_than_half_of_the_points_see_is_no_second_pulse(
    caplog: pytest.LogCaptureFixture,
) -> None:
    twice, once = (scan(1.0, (0.7, 0.3), second) for second in ((2e-9, 0.2), (0.0, 0.0)))
    most = np.arange(len(once.x_m)) % 9 < 5
    with caplog.at_level(logging.WARNING):
        correct_points(replace(once, counts=np.where(most[:, None], twice.counts, once.counts)))
    assert "second pulse" not in caplog.text


def about(done: CorrectedPoints, lag_ns: float, aside_ns: float = 0.2) -> float:
    """Photons a point that come about so late."""
    middle, half = round(lag_ns * 1e-9 / WIDTH_S), round(aside_ns * 1e-9 / WIDTH_S)
    return float(done.counts[:, middle - half : middle + half + 1].sum(axis=1).mean())


@pytest.mark.parametrize(("lag_ns", "percent"), [(1.013, 1), (2.0, 5), (4.8, 20)])
def test_a_second_pulse_is_taken_out_with_what_it_shows_once_more(
    lag_ns: float, percent: float, caplog: pytest.LogCaptureFixture
) -> None:
    hidden_ns = 2 * 0.7 / C * 1e9 + 0.3
    once = correct_points(scan(1.0, (0.7, 0.3), (0.0, 0.0)))
    with caplog.at_level(logging.WARNING):
        done = correct_points(scan(1.0, (0.7, 0.3), (lag_ns * 1e-9, percent / 100)))
    assert "taken out" in caplog.text
    [taken] = done.pulses
    assert taken.lag_s == pytest.approx(lag_ns * 1e-9, abs=2e-12)
    pulse, again = DIRECT * percent / 100, HIDDEN * percent / 100
    assert abs(about(done, lag_ns) - about(once, lag_ns)) < 0.01 * pulse + 3 * np.sqrt(pulse / len(done.counts))
    assert about(done, hidden_ns, 0.7) == pytest.approx(about(once, hidden_ns, 0.7), abs=0.03 * HIDDEN + 0.01 * pulse)
    assert abs(about(done, hidden_ns + lag_ns, 0.4) - about(once, hidden_ns + lag_ns, 0.4)) < 0.1 * again + 1


@pytest.mark.parametrize("pulses", [((2e-9, 0.05),), ((2e-9, 0.05), (3.4e-9, 0.1))])
def test_frames_of_a_scan_are_without_its_second_pulses(pulses: tuple[tuple[float, float], ...]) -> None:
    frame = scan(1.0, (0.7, 0.3), *pulses)
    whole = correct_points(frame)
    assert sorted(each.lag_s for each in whole.pulses) == pytest.approx([lag_s for lag_s, _ in pulses], abs=5e-12)
    assert whole.offsets is not None
    known = correct_points(frame, known=KnownDirect(whole.offsets.offset_bins, whole.pulses))
    np.testing.assert_allclose(known.counts, whole.counts, atol=1e-3)
    left = correct_points(frame, known=KnownDirect(whole.offsets.offset_bins))
    for lag_s, _ in pulses:
        assert abs(about(known, lag_s * 1e9)) < 0.02 * about(left, lag_s * 1e9)


def test_light_that_comes_again_and_again_is_taken_out_bin_by_bin() -> None:
    """From the definition, between bins as well; where no direct light is known, all of it is shifted."""
    random = np.random.default_rng(0)
    light, pulses = random.random((3, 200)), ((20.25, 0.15), (33.5, 0.3))
    seen, response = light.copy(), from_histogram([1.0, 4.0, 1.0], WIDTH_S)
    for lag, share in pulses:
        for late, part in ((int(lag), 1 - lag % 1), (int(lag) + 1, lag % 1)):
            seen[:, late:] += share * part * light[:, :-late]
    found = [SecondPulse(lag * WIDTH_S, share, 0.0, True, response, WIDTH_S) for lag, share in pulses]
    background = Background(np.full(3, 2.0), np.array([0.0, 0.0, np.nan]))
    even = np.array([[2.0], [2.0], [0.0]])  # of the last nothing is known, so all of it is light
    once, variance = without_second_pulses(seen + even, np.ones((3, 200)), np.full(3, np.nan), background, found)
    np.testing.assert_allclose(once, light + even, atol=1e-5)
    steps = [1, 1 + 0.15**2, 1 + 0.15**2 + 0.3**2]
    np.testing.assert_allclose(variance[:, [19, 20, 199]], [steps] * 3, atol=1e-6)


def test_the_direct_pulse_once_more_leaves_nothing_between_two_bins() -> None:
    """Narrower than a bin: shifted by half a bin it would be as wide as two."""
    response, at_bins, lag = from_histogram([1.0, 4.0, 1.0], WIDTH_S / 3), np.array([50.3, 61.8]), 20.5
    direct = np.array([[4000.0], [9000.0]])
    once, again = (direct * response.in_bins(-late * WIDTH_S, 200, WIDTH_S) for late in (at_bins, at_bins + lag))
    found = SecondPulse(lag * WIDTH_S, 0.2, 0.0, True, response, WIDTH_S)
    counts = 2.0 + once + 0.2 * again
    light, _ = without_second_pulses(counts, counts, at_bins, Background(np.full(2, 2.0), np.zeros(2)), [found])
    np.testing.assert_allclose(light, 2.0 + once, atol=2.0)
