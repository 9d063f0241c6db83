"""Hidden light that the next pulse overtakes: recorded before the direct light, where ambient light is measured."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S as C
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.constants import Quantity
from nlos.calibration.correct import correct_points
from nlos.calibration.measure import KnownBefore, measure_constants
from nlos.calibration.raw_points import RawPoints

SIDE, BINS, WIDTH_S, AMBIENT = 14, 400, 32e-12, 0.3
SCANNER_M = np.array([0.1, -0.2, 1.4])


def scan(far: float, ambient: float = AMBIENT) -> RawPoints:
    """A panel 0.6 m before the wall and, `far` times as bright, one at 1.6 m; a period is as long as the record, 12.8
    ns, and what is later comes round."""
    random = np.random.default_rng(5)
    at = (np.arange(SIDE) + 0.5) / SIDE - 0.5
    x, y = (each.ravel() for each in np.meshgrid(at, at[::-1]))
    counts = random.poisson(ambient, (len(x), BINS))
    for point, place in enumerate(np.stack([x, y, 0 * x], axis=1)):
        off_m = np.linalg.norm(SCANNER_M - place)
        ways_m = [np.zeros(random.poisson(4000))]
        for depth_m, photons in ((0.6, 200.0), (1.6, 200 * far)):
            hit = random.uniform([-0.4, -0.4, depth_m], [0.4, 0.4, depth_m], (random.poisson(photons), 3))
            ways_m.append(np.linalg.norm(hit - place, axis=1))
        times = 2 * (off_m + np.concatenate(ways_m)) / C - 7e-9
        bins = np.floor((times + random.normal(0, 25e-12, len(times))) / WIDTH_S).astype(int)
        counts[point] += np.bincount(bins % BINS, minlength=BINS)
    nothing = np.zeros(len(x))
    return RawPoints(counts, x, y, nothing + 1, nothing, nothing, TimeAxis(BINS, WIDTH_S))


def test_light_that_the_next_pulse_overtakes_is_not_subtracted_as_ambient_light(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.WARNING):
        done = correct_points(scan(3.0))
    assert "the next pulse overtakes it" in caplog.text
    assert float(done.background.per_bin.mean()) == pytest.approx(AMBIENT, rel=0.15)


@pytest.mark.parametrize("dead_time_s", [None, 77e-9])
@pytest.mark.parametrize("dark_per_bin", [None, 0.1])
def test_nor_where_the_benchs_constants_are_known_and_those_hold_ambient_light_alone(
    dead_time_s: float | None, dark_per_bin: float | None
) -> None:
    raw = scan(3.0)
    pulses = np.full(SIDE**2, 80e6)
    raw = replace(raw, sync_count=pulses, total_count=raw.counts.sum(axis=1, dtype=np.float64))
    shut = np.random.default_rng(8).poisson(dark_per_bin or 0.0, raw.counts.shape)
    dark = replace(raw, counts=shut, total_count=shut.sum(axis=1, dtype=np.float64))
    known = KnownBefore(dead_time=Quantity(dead_time_s, 1e-9) if dead_time_s else None)
    runs = [raw] if dark_per_bin is None else [raw, dark]
    found = measure_constants(runs, devices={}, sources=["run"] * len(runs), measured_utc="", known=known).constants
    ambient = AMBIENT - (dark_per_bin or 0.0)
    assert found.ambient_hz is not None
    assert found.ambient_hz.value == pytest.approx(ambient / WIDTH_S / 80e6, rel=0.2)
    done = correct_points(raw, found)
    assert float(done.background.per_bin.mean()) == pytest.approx(ambient, rel=0.2)


def test_late_afterpulses_are_no_ambient_light_and_are_named(caplog: pytest.LogCaptureFixture) -> None:
    raw, random = scan(0.0, 0.01), np.random.default_rng(10)
    after = random.poisson(0.03 * raw.counts.sum(axis=1))  # of clicks; 30 ns later and more
    late = np.repeat(raw.counts.argmax(axis=1), after) + (30e-9 + random.exponential(10e-9, after.sum())) / WIDTH_S
    place, later = np.repeat(np.arange(SIDE**2), after), late.astype(int) % (3 * BINS)  # of the period the record's
    counts = raw.counts.copy()
    np.add.at(counts, (place[later < BINS], later[later < BINS]), 1)
    with caplog.at_level(logging.WARNING):
        done = correct_points(replace(raw, counts=counts))
    assert "late afterpulses" in caplog.text
    assert float(done.background.per_bin.mean()) < 0.75 * counts[:, :40].mean()


def test_a_detector_that_is_blind_behind_the_pulse_is_no_late_light(caplog: pytest.LogCaptureFixture) -> None:
    raw = scan(0.0, 3.0)
    pulses = np.full(SIDE**2, 8000.0)
    live = np.exp(-np.cumsum(raw.counts, axis=1) / pulses[:, None])  # one click a pulse
    seen = np.random.default_rng(9).binomial(raw.counts, live)
    raw = replace(raw, counts=seen, sync_count=pulses, total_count=seen.sum(axis=1, dtype=np.float64))
    with caplog.at_level(logging.WARNING):
        correct_points(raw)
    assert "overtakes" not in caplog.text


@pytest.mark.parametrize("ambient", [0.0, 0.01, 0.3, 3.0])
def test_ambient_light_is_as_it_was_where_nothing_comes_round(ambient: float, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        done = correct_points(scan(0.0, ambient))
    assert "overtakes" not in caplog.text
    assert float(done.background.per_bin.mean()) == pytest.approx(ambient, rel=0.1, abs=1e-3)


@pytest.mark.parametrize(("more", "leaks"), [(37, 0.0), (130, 0.0), (37, 0.02), (130, 0.02)])
def test_ambient_light_is_as_it_was_where_the_period_or_a_gate_ends_within_the_record(
    more: int, leaks: float, caplog: pytest.LogCaptureFixture
) -> None:
    whole = scan(0.0)
    kept = BINS if leaks == 0 else BINS - more  # a record longer than the period, or a gate that closes
    dark = np.random.default_rng(6).poisson(AMBIENT * leaks, (len(whole.counts), more))
    counts = np.concatenate([whole.counts[:, :kept], dark], axis=1)
    with caplog.at_level(logging.WARNING):
        done = correct_points(replace(whole, counts=counts, time=TimeAxis(kept + more, WIDTH_S)))
    assert "overtakes" not in caplog.text
    assert float(done.background.per_bin.mean()) == pytest.approx(AMBIENT, rel=0.1)


def test_frames_are_rid_of_the_ambient_light_that_their_whole_scan_tells() -> None:
    raw = scan(3.0)
    whole = correct_points(raw)
    assert whole.offsets is not None
    frame = correct_points(raw, known=whole.known(whole.offsets.offset_bins))
    np.testing.assert_array_equal(frame.background.per_bin, whole.background.per_bin)


def test_ambient_light_that_changes_is_each_points_own_there_too() -> None:
    raw, ambient = scan(3.0, 0.0), np.linspace(1.0, 3.0, SIDE**2)
    counts = raw.counts + np.random.default_rng(7).poisson(ambient[:, None], raw.counts.shape)
    found = correct_points(replace(raw, counts=counts)).background.per_bin
    np.testing.assert_allclose(found, ambient, atol=1.2)
    assert np.corrcoef(found, ambient)[0, 1] > 0.8
