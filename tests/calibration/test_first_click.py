"""Pile-up of a dead time that nobody knows, photon by photon: what is hidden comes back, and doubts are said."""

import gc
import logging
import weakref
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.calibration.detector import undo_dead_time
from nlos.calibration.first_click import Blindness, correct_first_click, doubt_pile_up, first_click
from nlos.calibration.raw_points import RawPoints

PULSES, PERIOD_S, WIDTH_S, DIRECT_S, LATE_S = 20_000, 100e-9, 50e-12, 5e-9, 7e-9
ALBEDO = np.linspace(0.1, 1.0, 10)


def clicks_of(dead_s: float, photons: float, late: float, even_hz: float, bins: int = 400) -> RawPoints:
    """Ten points with `photons` a pulse of the brightest at 5 ns (70 ps wide), of `late` at 7 ns, and even light; each
    click makes the detector blind for `dead_s`. Every photon of all pulses in its order."""
    random = np.random.default_rng(8)
    counts, total = np.zeros((len(ALBEDO), bins), np.uint32), np.zeros(len(ALBEDO))
    for point, bright in enumerate(ALBEDO):
        numbers = random.poisson([photons * bright * PULSES, late * bright * PULSES])
        number = int(numbers.sum())
        place = np.repeat([DIRECT_S, LATE_S], numbers) + random.normal(0, 30e-12, number)
        times = random.integers(0, PULSES, number) * PERIOD_S + place
        even = random.random(random.poisson(even_hz * PULSES * PERIOD_S)) * PULSES * PERIOD_S
        times = np.sort(np.concatenate([times, even]))
        again, at, seen = np.searchsorted(times, times + dead_s).tolist(), 0, []
        while at < len(times):
            seen.append(at)
            at = again[at]
        inside = np.floor(times[seen] % PERIOD_S / WIDTH_S).astype(int)
        counts[point], total[point] = np.bincount(inside[inside < bins], minlength=bins), len(seen)
    each = np.ones(len(ALBEDO))
    return RawPoints(
        counts, each, each, each * PULSES * PERIOD_S, each * PULSES, total, TimeAxis(bins, WIDTH_S)
    )  # fmt: skip


def near(counts: npt.NDArray[np.generic], time_s: float) -> npt.NDArray[np.float64]:
    """Counts of each point within 300 ps of a time."""
    middle = round(time_s / WIDTH_S)
    return np.asarray(counts[:, middle - 6 : middle + 6], dtype=np.float64)


@pytest.mark.parametrize("dead_s", [40e-9, 77e-9])
def test_whatever_the_dead_time_is_late_light_is_as_bright_as_it_was(
    dead_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    """Up to two photons a pulse: of the brightest point's late light a seventh is seen."""
    raw = clicks_of(dead_s, 2.0, 0.1, 1e4)
    photons, variance = undo_dead_time(raw, None)
    late, spread = near(photons, LATE_S).sum(axis=1), np.sqrt(near(variance, LATE_S).sum(axis=1))
    even = 12 * 1e4 * WIDTH_S * PULSES
    assert np.abs((late - even - 0.1 * ALBEDO * PULSES) / spread).max() < 3.5
    assert near(raw.counts, LATE_S).sum(axis=1)[-1] < 0.2 * 0.1 * PULSES
    bins = np.arange(12) + 0.5
    direct = near(photons, DIRECT_S) @ bins / near(photons, DIRECT_S).sum(axis=1)
    clicked = near(raw.counts, DIRECT_S) @ bins / near(raw.counts, DIRECT_S).sum(axis=1)
    assert np.ptp(direct) < 0.06 < 0.2 < np.ptp(clicked)  # of one time, however bright
    with caplog.at_level(logging.WARNING):
        doubt_pile_up(raw)
    assert "undone as of one click in the 20 ns of a record" in caplog.text


def test_even_light_tells_whether_the_detector_is_blind_until_the_record_ends() -> None:
    assert first_click(clicks_of(77e-9, 2.0, 0.1, 1e6)).blindness is Blindness.SEEN


@pytest.mark.parametrize("dead_s", [15e-9, 22e-9, 29.3e-9])
def test_a_dead_time_that_ends_in_the_record_is_told_with_its_error(dead_s: float) -> None:
    found = first_click(clicks_of(dead_s, 1.0, 0.0, 1e6, bins=1000)).dead_time
    assert found is not None
    assert abs(found.value - dead_s) < 3 * found.error
    assert found.error < 2e-9


def test_a_detector_that_is_soon_live_again_is_not_taken_for_a_blind_one(caplog: pytest.LogCaptureFixture) -> None:
    """Blind for 1 ns, the late light is whole: undone as of one click a pulse it would be seven times as bright."""
    raw = clicks_of(1e-9, 2.0, 0.1, 1e6)
    assert undo_dead_time(raw, None)[0] is raw.counts
    with caplog.at_level(logging.WARNING):
        doubt_pile_up(raw)
    assert "It is not undone (as many clicks" in caplog.text


def test_few_clicks_are_left_as_they_are() -> None:
    raw = clicks_of(77e-9, 0.02, 0.001, 1e4)
    assert first_click(raw).blindness is Blindness.NOT_DOUBTED
    assert undo_dead_time(raw, None)[0] is raw.counts


def test_a_scan_is_asked_once_and_kept_no_longer_than_it_is_held() -> None:
    raw = clicks_of(77e-9, 2.0, 0.1, 1e6)
    found, held = first_click(raw), weakref.ref(raw)
    assert first_click(raw) is found
    assert first_click(replace(raw, sync_count=100 * raw.sync_count)).blindness is Blindness.NOT_DOUBTED
    del raw
    gc.collect()
    assert held() is None


def test_bins_for_which_no_pulse_is_left_and_points_without_pulses() -> None:
    photons, variance = correct_first_click([[30, 50, 20, 0], [1, 2, 3, 4]], [100, 0])
    assert photons[0, :2] == pytest.approx([-100 * np.log(0.7), -100 * np.log(2 / 7)])
    assert np.isinf(variance[0]).tolist() == [False, False, True, True]
    assert photons[1].tolist() == variance[1].tolist() == [1, 2, 3, 4]
