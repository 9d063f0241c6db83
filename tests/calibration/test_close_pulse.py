"""A second pulse that overlaps with the direct one, photon by photon, and surfaces that are as near."""

import logging
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S as C
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.close_pulse import ClosePulse, close_pulse
from nlos.calibration.correct import correct_points
from nlos.calibration.raw_points import RawPoints

SIDE, BINS, WIDTH_S, DIRECT, HIDDEN = 14, 700, 16e-12, 4000, 300
SCANNER_M = np.array([0.25, 0.1, 1.5])


def scan(
    patch_m: tuple[float, float], lag_s: float, share: float, wall_m: float = 1.0, sigma_s: float = 25e-12
) -> RawPoints:
    """A square patch `patch_m` (depth, side) before a wall whose points reflect 1 to 3; of every photon a share more
    comes `lag_s` later. 60 ps FWHM."""
    random = np.random.default_rng(4)
    at = (np.arange(SIDE) + 0.5) / SIDE * wall_m - wall_m / 2
    x, y = (each.ravel() for each in np.meshgrid(at, at[::-1]))
    counts = np.zeros((len(x), BINS), np.uint32)
    for point, place in enumerate(np.stack([x, y, 0 * x], axis=1)):
        direct = random.poisson(DIRECT * random.uniform(0.5, 1.5))
        hit = np.stack([*random.uniform(-0.5, 0.5, (2, 2000)) * patch_m[1], np.full(2000, patch_m[0])], axis=1)
        way_m = np.linalg.norm(hit - place, axis=1)
        bright = (patch_m[0] / way_m) ** 4
        way_m = way_m[random.random(2000) < bright / 2000 * HIDDEN * 4]
        times = 2 * (np.linalg.norm(SCANNER_M - place) + np.concatenate([np.zeros(direct), way_m])) / C - 6e-9
        times = np.concatenate([times, times[random.random(len(times)) < share] + lag_s])
        bins = np.floor((times + random.normal(0, sigma_s, len(times))) / WIDTH_S).astype(int)
        counts[point] = np.bincount(bins[(bins >= 0) & (bins < BINS)], minlength=BINS) + random.poisson(0.02, BINS)
    nothing = np.zeros(len(x))
    return RawPoints(counts, x, y, nothing + 1, nothing, nothing, TimeAxis(BINS, WIDTH_S))


@pytest.mark.parametrize(("lag_ps", "percent"), [(150, 30), (200, 5), (240, 2)])
def test_a_second_pulse_a_few_widths_behind_the_direct_one_is_told_and_masked(
    lag_ps: float, percent: float, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        done = correct_points(scan((0.6, 0.3), lag_ps * 1e-12, percent / 100))
    assert caplog.text.count("a second pulse comes") == 1
    words = caplog.text.split()
    assert float(words[words.index("comes") + 1]) == pytest.approx(lag_ps / 1000, abs=0.03)
    assert float(words[words.index("%") - 1]) == pytest.approx(percent, rel=0.35)
    early = done.counts[:, : round(1e-9 / WIDTH_S)].mean(axis=0)  # nothing hidden is as near
    assert early.max() < 0.002 * DIRECT * WIDTH_S / 60e-12


@pytest.mark.parametrize(("lag_ps", "percent"), [(780, 30), (700, 5), (900, 10)])
def test_one_behind_a_slow_detectors_pulse_is_masked_though_it_is_late(lag_ps: float, percent: float) -> None:
    """Four of its widths or less: until there the pulses are not apart."""
    done = correct_points(scan((0.6, 0.3), lag_ps * 1e-12, percent / 100, sigma_s=94e-12))
    alone = correct_points(scan((0.6, 0.3), 0.0, 0.0, sigma_s=94e-12))
    assert done.direct.close is not None
    assert done.direct.close.lag_s == pytest.approx(lag_ps * 1e-12, abs=0.04e-9)
    behind = slice(done.direct.end_bin, round(2.4e-9 / WIDTH_S))  # before the hidden patch
    assert done.counts[:, behind].mean() < alone.counts[:, behind].mean() + 0.02


def test_the_direct_pulse_of_aligned_histograms_is_as_wide_as_its_falling_half_says() -> None:
    bins = np.arange(200)
    pulse, again = (np.exp(-4 * np.log(2) * ((bins - at) / 5) ** 2) for at in (0, 24))
    smooth = 200 * (pulse + 0.01 * np.exp(-bins / 6) + 0.01 * again) + 0.02
    counts = np.random.default_rng(3).poisson(np.multiply.outer(np.linspace(0.5, 1.5, 400), smooth)).astype(np.float32)
    found = close_pulse(counts, smooth, (0, 17), WIDTH_S)  # 4.8 widths behind it
    assert found is not None
    assert found.lag_s == pytest.approx(24 * WIDTH_S)


def two_pulses(
    lag: int,
    *,
    share: float = 0.1,
    wide: float = 5.0,
    again: float = 5.0,
    base: float = 0.0,
    differ: float = 0.0,
    photons: float = 4000.0,
    bin_width_s: float = WIDTH_S,
) -> ClosePulse | None:
    """What is found in histograms without noise that begin at the maximum of a pulse `wide` bins wide, of which
    `share` comes `lag` bins later, `again` bins wide, on a `base`; at half of the points more of it by `differ`, at
    the others less."""
    bins = np.arange(200)
    first, second = (np.exp(-4 * np.log(2) * ((bins - at) / of) ** 2) for at, of in ((0, wide), (lag, again)))
    each = share * (1 + differ * np.tile([[-1.0], [1.0]], (200, 1)))
    counts = photons * np.linspace(0.5, 1.5, 400)[:, None] * (first + base + each * second)
    smooth = photons * (first + base + share * second)
    turn = int(np.argmin(smooth[:lag]))
    return close_pulse(counts.astype(np.float32), smooth, (0, turn), bin_width_s)


@pytest.mark.parametrize(
    ("lag", "share", "base", "end_bin", "as_high"),
    [
        (12, 0.1, 0.0, 18, 0.0916),  # as far behind its maximum as the minimum is before it; both stand on its flanks
        (20, 0.1, 0.0, 30, 0.1),
        (29, 0.1, 0.0, 39, 0.1),  # three half widths, the maximum's bin and one more
        (20, 0.1, 0.02, 30, 0.098),
        (20, 0.003, 0.0, 30, 0.003),
    ],
)
def test_a_second_pulse_is_masked_to_its_end_and_told_as_high_as_it_is(
    lag: int, share: float, base: float, end_bin: int, as_high: float
) -> None:
    found = two_pulses(lag, share=share, base=base, photons=1e5)
    assert found is not None
    assert found.lag_s == pytest.approx(lag * WIDTH_S)
    assert found.end_bin == end_bin
    assert found.share == pytest.approx(as_high, rel=5e-3)


@pytest.mark.parametrize(
    ("there", "none"),
    [
        ({"lag": 18, "bin_width_s": 64e-12}, {"lag": 20, "bin_width_s": 64e-12}),  # 1.2 ns, whatever its width
        ({"lag": 18, "bin_width_s": 32e-12, "share": 0.01}, {"lag": 20, "bin_width_s": 32e-12, "share": 0.01}),
        ({"lag": 29, "bin_width_s": 10e-12}, {"lag": 32, "bin_width_s": 10e-12}),  # six widths
        ({"lag": 18, "wide": 3.0, "again": 14.0}, {"lag": 18, "wide": 3.0, "again": 16.0}),
        ({"lag": 20, "differ": 0.25}, {"lag": 20, "differ": 0.35}),
        (
            {"lag": 20, "share": 0.0015, "base": 0.01, "photons": 1e5},
            {"lag": 20, "share": 0.0009, "base": 0.01, "photons": 1e5},
        ),
        ({"lag": 20, "share": 0.02, "photons": 40.0}, {"lag": 20, "share": 0.01, "photons": 4.0}),
    ],
    ids=["late", "as a surface", "widths behind", "wide", "uneven", "faint", "unsure"],
)
def test_what_is_late_wide_uneven_faint_or_unsure_is_no_second_pulse(
    there: dict[str, Any], none: dict[str, Any]
) -> None:
    assert two_pulses(**there) is not None
    assert two_pulses(**none) is None


def test_one_that_can_be_taken_out_is_so_with_what_it_shows_once_more(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        done = correct_points(scan((0.6, 0.3), 270e-12, 0.2))
    assert "It is taken out" in caplog.text
    assert caplog.text.count("a second pulse comes") == 1
    assert done.direct.close is not None  # what is left of it is masked
    assert done.direct.end_bin == done.direct.close.end_bin
    alone = correct_points(scan((0.6, 0.3), 0.0, 0.0))
    shared = slice(alone.direct.end_bin + 5, min(done.time.bins, alone.time.bins))
    seen, true = (each.counts[:, shared].sum(axis=0) for each in (done, alone))
    assert seen.sum() == pytest.approx(true.sum(), rel=0.04)  # if it were only masked, a fifth more


@pytest.mark.parametrize("patch_m", [(0.025, 0.1), (0.04, 0.4), (0.06, 0.3), (0.08, 0.6), (0.6, 0.3)])
def test_a_surface_close_to_the_wall_is_no_second_pulse(
    patch_m: tuple[float, float], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        correct_points(scan(patch_m, 0.0, 0.0))
    assert "second pulse" not in caplog.text


def test_frames_of_few_photons_are_masked_as_far_as_their_whole_scan_is() -> None:
    raw = scan((0.6, 0.3), 200e-12, 0.05)
    whole = correct_points(raw)
    assert whole.offsets is not None
    few = np.random.default_rng(1).binomial(raw.counts.astype(np.int64), 0.01)
    frame = correct_points(replace(raw, counts=few), known=whole.known(whole.offsets.offset_bins))
    assert frame.direct.close is None
    assert frame.direct.end_bin == whole.direct.end_bin
    assert not frame.usable[:, : whole.direct.end_bin].any()
    assert not frame.counts[:, : whole.direct.end_bin].any()


def test_a_close_one_a_later_one_and_their_product_are_taken_out_together(caplog: pytest.LogCaptureFixture) -> None:
    once = scan((0.6, 0.3), 1.5e-9, 0.2)
    counts = once.counts.astype(np.int64)
    counts[:, 16:] += np.random.default_rng(5).binomial(once.counts[:, :-16].astype(np.int64), 0.1)  # 0.256 ns later
    with caplog.at_level(logging.WARNING):
        done = correct_points(replace(once, counts=counts))
    taken = sorted((each.lag_s, each.share) for each in done.pulses)
    lags_s, shares = np.transpose(taken)
    np.testing.assert_allclose(lags_s, [0.256e-9, 1.5e-9, 1.756e-9], atol=1e-11)
    np.testing.assert_allclose(shares, [0.1, 0.2, 0.02], rtol=0.05)
    assert caplog.text.count("It is taken out") == 3
    assert "It is masked with the direct light" not in caplog.text
