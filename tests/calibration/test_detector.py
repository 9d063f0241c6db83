"""What a detector makes of the light, photon by photon and click by click, against what is made of its clicks again."""

import heapq
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.calibration.constants import BenchConstants, Quantity, load, save
from nlos.calibration.correct import correct_points
from nlos.calibration.detector import subtract_dark, undo_dead_time
from nlos.calibration.direct_reflection import known_direct_light
from nlos.calibration.known_direct import KnownDirect
from nlos.calibration.measure import measure_constants
from nlos.calibration.raw_points import RawPoints

BINS, WIDTH_S, PULSES = 100, 1e-9, 4_000_000
PERIOD_S = BINS * WIDTH_S
DEAD_BINS, PROBABILITY, DECAY_BINS = 40, 0.15, 20.0
NOTHING = BenchConstants({}, "2026-01-01", (), WIDTH_S)
KNOWN = replace(
    NOTHING,
    dead_time_s=Quantity(DEAD_BINS * WIDTH_S, 0.0),
    afterpulse_probability=Quantity(PROBABILITY, 1e-4),
    afterpulse_decay_s=DECAY_BINS * WIDTH_S,
)


def clicks_of(photons: npt.NDArray[np.int64], seed: int = 4, pulses: int = PULSES) -> npt.NDArray[np.int64]:
    """Counts (T,) of a detector that is blind after each click, and then clicks once more by itself now and then; of
    `photons` (T,) over all pulses, each at a pulse of its own."""
    random = np.random.default_rng(seed)
    bins = np.repeat(np.arange(BINS), photons)
    pending = (random.integers(0, pulses, len(bins)) * BINS + bins + random.random(len(bins))).tolist()
    heapq.heapify(pending)
    clicks, live_from = np.zeros(BINS, np.int64), -1.0
    while pending:
        time = heapq.heappop(pending)
        if time < live_from:
            continue
        clicks[int(time) % BINS] += 1
        live_from = time + DEAD_BINS
        if random.random() < PROBABILITY:
            heapq.heappush(pending, live_from + random.exponential(DECAY_BINS))
    return clicks


def points(clicks: npt.NDArray[np.int64], total: float, bins: int = BINS) -> RawPoints:
    """One histogram of the first `bins`."""
    one = np.ones(1)
    return RawPoints(clicks[None, :bins], 0 * one, 0 * one, PULSES * PERIOD_S * one, PULSES * one, total * one,
                     TimeAxis(bins, WIDTH_S))  # fmt: skip


def test_dead_time_and_afterpulses_undone_leave_the_photons() -> None:
    photons = np.full(BINS, 1_500)
    photons[10] = 60_000
    clicks = clicks_of(photons)
    told, _ = undo_dead_time(points(clicks, clicks.sum()), KNOWN)
    assert told.sum() == pytest.approx(photons.sum(), rel=0.005)
    behind = slice(10 + DEAD_BINS, 10 + DEAD_BINS + 40)  # there most afterpulses are the pulse's
    assert told[0, behind].sum() == pytest.approx(photons[behind].sum(), rel=0.03)
    uncorrected, _ = undo_dead_time(points(clicks, clicks.sum()), replace(KNOWN, afterpulse_probability=None))
    assert uncorrected[0, behind].sum() > 1.1 * photons[behind].sum()


def test_afterpulses_of_bright_light_are_undone_bin_by_bin() -> None:
    """One photon a pulse: the detector is blind for most pulses, but never at the end of a click's own dead time."""
    photons, pulses = np.full(BINS, 900), 300_000
    photons[10] = pulses
    clicks = clicks_of(photons, pulses=pulses)
    bright = replace(
        points(clicks, clicks.sum()), sync_count=np.full(1, pulses), exposure_s=np.full(1, pulses * PERIOD_S)
    )
    told, _ = undo_dead_time(bright, KNOWN)
    behind = told[0, 11 + DEAD_BINS : 96].reshape(-1, 5).sum(axis=1) / (5 * 900)
    assert np.abs(behind - 1).max() < 0.15
    assert behind.mean() == pytest.approx(1, abs=0.03)


def test_afterpulses_of_a_record_that_is_a_little_longer_than_the_period_are_undone() -> None:
    photons = np.full(BINS, 1_500)
    photons[10] = 60_000
    clicks = np.repeat(clicks_of(photons), 2) // 2
    same = replace(points(clicks, clicks.sum(), 2 * BINS), time=TimeAxis(2 * BINS, WIDTH_S / 2))
    longer = replace(same, counts=np.pad(same.counts, ((0, 0), (0, 1))), time=TimeAxis(2 * BINS + 1, WIDTH_S / 2))
    told, _ = undo_dead_time(longer, KNOWN)
    assert np.allclose(told[0, :-1], undo_dead_time(same, KNOWN)[0])
    assert told[0, -1] == 0


@pytest.mark.parametrize(("bins", "total_known"), [(BINS, True), (BINS, False), (25, True), (25, False)])
def test_the_dark_rate_is_that_of_all_the_time_whatever_the_window_holds(bins: int, total_known: bool) -> None:
    """Also where a source tells the clicks of its window alone."""
    dark_hz = 50_000.0
    clicks = np.random.default_rng(0).poisson(np.full(BINS, dark_hz * WIDTH_S * PULSES))
    run = points(clicks, float(clicks.sum()) if total_known else 0.0, bins)
    found = measure_constants([run], devices={}, sources=[], measured_utc="2026-01-01").constants.dark_hz
    assert found is not None
    assert abs(found.value - dark_hz) < 3 * found.error
    share = 1.0 if total_known else bins / BINS
    assert found.error == pytest.approx(np.sqrt(dark_hz / share / (PULSES * PERIOD_S)), rel=0.05)


def test_dark_runs_with_and_without_all_their_clicks_tell_one_rate_together() -> None:
    clicks = np.random.default_rng(1).poisson(np.full(BINS, 20_000))
    runs = [points(clicks, float(clicks.sum()), 25), points(clicks, 0.0, 25)]
    found = measure_constants(runs, devices={}, sources=[], measured_utc="2026-01-01").constants.dark_hz
    assert found is not None
    assert found.value == pytest.approx(clicks.sum() / (PULSES * PERIOD_S), rel=0.01)


def test_direct_light_of_a_known_shape_has_all_its_photons_back() -> None:
    """Also those of its tail, where the hidden light is; the histogram is drawn photon by photon."""
    random, photons = np.random.default_rng(2), (400, 90_000)
    shape = 0.6 * np.exp(-0.5 * ((np.arange(80) - 5) / 2) ** 2) / 5.0 + 0.4 * np.exp(-np.arange(80) / 15) / 15.5
    shape /= shape.sum()
    edges = np.append(0.0, np.cumsum(shape))
    aligned = np.stack([np.histogram(random.random(number), np.append(edges[:-1], 1.0))[0] for number in photons])
    aligned[:, 50] += 3_000  # what is behind the corner
    direct = known_direct_light(aligned, shape, 12)
    assert shape[:12].sum() == pytest.approx(0.82, abs=0.01)
    for number, found in zip(photons, direct.amplitude, strict=True):
        assert abs(found - number) < 4 * np.sqrt(number / shape[:12].sum())


@pytest.mark.parametrize("kept", [True, False])
def test_dark_counts_are_taken_from_where_they_lie_in_time(kept: bool, tmp_path: Path) -> None:
    """A dark run of other bins than the scan's: a hot nanosecond is subtracted where it is, not from the bin of its
    number. A file that does not say when its bins were is used for such bins alone."""
    hot = np.full(64, 10.0)
    hot[20] = 1000.0  # 30 to 31 ns
    axis = TimeAxis(64, 1e-9, 10e-9) if kept else None
    save(replace(NOTHING, dark_hz=Quantity(1630.0, 1.0), dark_per_bin_hz=hot, dark_time=axis), tmp_path / "c.h5")
    constants = load(tmp_path / "c.h5")
    for time, bins in (
        (TimeAxis(64, 1e-9, 10e-9), {20: 1000.0}),
        (TimeAxis(64, 1e-9, 12e-9), {18: 1000.0}),
        (TimeAxis(128, 0.5e-9, 10e-9), {40: 500.0, 41: 500.0}),
    ):
        raw = RawPoints(np.zeros((1, time.bins)), *[np.ones(1)] * 5, time)  # 1 s
        taken = -np.asarray(subtract_dark(raw.counts, raw, constants))[0]
        if not kept and time.bin_width_s != 1e-9:
            assert not taken.any()
        elif kept:
            assert {int(k): taken[k] for k in np.flatnonzero(taken > 50)} == pytest.approx(bins)
            beside = time.bin_width_s / 1e-9 * hot.mean()
            assert taken[-2] == pytest.approx(beside if time.start_s > 10e-9 else 10.0 * time.bin_width_s / 1e-9)


@pytest.mark.parametrize("by", [0.0, 0.5])
def test_bins_whose_photons_nobody_can_tell_are_not_used(by: float) -> None:
    """Blind for 40 +- 2 ns after two photons a pulse in bin 10; a shift by half a bin mixes those with bins beside."""
    clicks = np.full(BINS, 2_000)
    clicks[10] = PULSES * -np.expm1(-2.0)
    raw = points(clicks, clicks.sum())
    known = replace(NOTHING, dead_time_s=Quantity(DEAD_BINS * WIDTH_S, 2 * WIDTH_S))
    done = correct_points(raw, known, known=KnownDirect(np.array([by])), remove_direct=False)
    hidden = [47, 48, 49, 50, 51] if by else [48, 49, 50, 51]
    assert np.flatnonzero(~done.usable[0]).tolist() == hidden
    assert not done.counts[0, hidden].any()
    assert np.isfinite(done.variance).all()
