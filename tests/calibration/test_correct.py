import logging
from dataclasses import replace

import numpy as np
import pytest

from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.calibration.constants import BenchConstants, Quantity
from nlos.calibration.correct import correct, correct_points
from nlos.calibration.direct_reflection import find_direct_light
from nlos.calibration.errors import InvalidData, SaturatedBins
from nlos.calibration.known_direct import KnownDirect
from nlos.calibration.measure import measure_constants
from nlos.calibration.raw_points import RawPoints, from_samples
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag
from tests.calibration.conftest import RawScan, make_raw_scan


def raw(scan: RawScan, counts: np.ndarray | None = None, exposure_s: np.ndarray | None = None) -> RawPoints:
    points, bins = scan.counts.shape
    return RawPoints(
        scan.counts if counts is None else counts,
        scan.x_m,
        scan.y_m,
        np.ones(points) if exposure_s is None else exposure_s,
        np.zeros(points),
        np.zeros(points),
        TimeAxis(bins, scan.bin_width_s),
    )


def test_time_zero_is_the_direct_arrival_and_only_the_hidden_light_is_left() -> None:
    scan = make_raw_scan(direct_counts=40_000)
    done = correct_points(raw(scan))
    assert done.time.start_s == 0
    return_bins = 2 * np.sqrt((scan.x_m - 0.2) ** 2 + scan.y_m**2 + 0.9**2) / 299_792_458 / scan.bin_width_s
    for point in (0, 100, 255):
        near = slice(int(return_bins[point]) - 3, int(return_bins[point]) + 6)
        assert done.counts[point, near].sum() == pytest.approx(scan.hidden[point].sum(), abs=25)
    assert done.counts[:, : done.direct.end_bin].max() == 0
    assert not done.counts[~done.usable].any()
    elsewhere = done.usable & (np.abs(np.arange(done.time.bins) - return_bins[:, None]) > 20)
    assert abs(done.counts[elsewhere].mean()) < 0.05
    rest = (done.counts / np.sqrt(np.maximum(done.variance, 0.2)))[elsewhere]
    assert rest.std() < 1.3


@pytest.mark.parametrize("direct_counts", [1200.0, 1600.0])
def test_direct_light_that_hardly_outshines_hidden_light_is_removed(direct_counts: float) -> None:
    """On a small wall returns come at nearly the same time: in the mean the pulse is less than 3 times as bright."""
    scan = make_raw_scan(wall_m=0.1, direct_counts=direct_counts, hidden_counts=1000.0)
    kept, done = correct_points(raw(scan), remove_direct=False), correct_points(raw(scan))
    mean = kept.counts.mean(axis=0)
    assert mean[:3].max() < 3 * mean[30:].max()
    assert 2 < done.direct.end_bin < 30
    assert done.counts[:, : done.direct.end_bin].max() == 0
    assert np.abs(done.counts[:, done.direct.end_bin : 150].mean(axis=0)).max() < 0.01 * mean.max()
    assert done.counts[:, 150:].sum() == pytest.approx(scan.hidden.sum(), rel=0.02)


@pytest.mark.parametrize("level", [0.003, 0.3, 30.0])
def test_what_is_no_pulse_is_not_taken_for_direct_light(level: float) -> None:
    """Noise; and light of an object that reaches the wall, brightest where that does."""
    rng = np.random.default_rng(0)
    for trial in range(20):
        noise = rng.poisson(level, (100 + trial, 400))
        assert find_direct_light(noise, 32e-12).end_bin == 0
    near = rng.poisson(level + 5 * np.exp(-np.arange(400) / 40), (100, 400))
    assert find_direct_light(near, 32e-12).end_bin == 0


def test_the_model_gives_back_what_was_removed(raw_scan: RawScan) -> None:
    kept, removed = correct_points(raw(raw_scan), remove_direct=False), correct_points(raw(raw_scan))
    again = removed.counts + removed.direct.counts()
    usable = removed.usable
    assert np.allclose(again[usable], kept.counts[usable], atol=1e-2)


def test_rectified_scans_without_direct_light_are_left_alone() -> None:
    counts = np.random.default_rng(0).poisson(2.0, (100, 6, 6)).astype(np.float32)
    counts[60:64] += 30
    scan = Transient(counts, np.ones((6, 6)), WallGrid(1, 1, 6, 6), TimeAxis(100, 32e-12))
    done = correct(scan, rectified=True)
    assert (done.transient.counts == counts).all()
    assert done.points.usable.all()


def test_unmeasured_points_stay_unmeasured(raw_scan: RawScan) -> None:
    exposure = np.linspace(0.5, 2.0, 256)
    exposure[10] = 0
    done = correct_points(raw(raw_scan, exposure_s=exposure))
    assert (done.exposure_s == exposure).all()
    assert not done.usable[10].any()
    assert not done.counts[10].any()


@pytest.mark.parametrize("every", [3, 10])
def test_points_that_nobody_measured_change_nothing_at_the_others(every: int) -> None:
    """Most of a grid may be empty: its zeros are no dark points, and no pulse is as faint as theirs."""
    scan = make_raw_scan(background=0.6, direct_counts=3000)
    points = raw(scan)
    lit = np.arange(len(scan.x_m)) % every == 0
    exposed = np.where(lit, points.exposure_s, 0.0)
    sparse = correct_points(replace(points, counts=scan.counts * lit[:, None], exposure_s=exposed))
    alone = correct_points(points.select(lit))
    assert sparse.offsets is not None
    assert alone.offsets is not None
    np.testing.assert_allclose(sparse.offsets.error_bins[lit], alone.offsets.error_bins, rtol=0.01)
    np.testing.assert_allclose(sparse.offsets.offset_bins[lit], alone.offsets.offset_bins, atol=1e-3)
    np.testing.assert_allclose(sparse.background.per_bin[lit], alone.background.per_bin, rtol=1e-4)
    bins = min(sparse.time.bins, alone.time.bins)
    np.testing.assert_allclose(sparse.counts[lit, :bins].sum(), alone.counts[:, :bins].sum(), rtol=2e-3)


def test_a_point_whose_arrival_nobody_knows_was_not_exposed(raw_scan: RawScan) -> None:
    arrival = np.asarray(raw_scan.arrival_bins, dtype=np.float64).copy()
    arrival[10] = np.nan
    done = correct_points(raw(raw_scan), known=KnownDirect(arrival))
    assert np.flatnonzero(done.exposure_s == 0).tolist() == [10]
    assert not done.usable[10].any()
    assert done.usable[:10, -1].all()
    assert done.usable[11:, -1].all()


def test_the_last_bin_is_one_that_every_point_recorded() -> None:
    done = correct_points(raw(make_raw_scan(direct_counts=40_000)))
    assert done.usable[:, -1].all()


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (np.nan, r"point 37 at .* bin 5 is nan: counts must be finite"),
        (np.inf, r"point 37 at .* bin 5 is inf: counts must be finite"),
        (-1.0, r"point 37 at .* bin 5 is -1.0: raw counts are never negative"),
        (65535.0, r"point 37 at \(-0\.312 m, \+0\.688 m\), bin 5 holds 65535 counts.*saturated"),
    ],
)
def test_bad_counts_are_refused_by_point_and_reason(raw_scan: RawScan, bad: float, reason: str) -> None:
    counts = raw_scan.counts.astype(np.float64)
    counts[37, 5] = bad
    with pytest.raises(SaturatedBins if bad == 65535 else InvalidData, match=reason):
        correct_points(raw(raw_scan, counts))


def test_a_wrong_exposure_is_refused_by_point(raw_scan: RawScan) -> None:
    exposure = np.ones(256)
    exposure[3] = np.nan
    with pytest.raises(InvalidData, match=r"point 3 at .* has an exposure of nan"):
        correct_points(raw(raw_scan, exposure_s=exposure))


def test_a_scan_of_nothing_is_refused(raw_scan: RawScan) -> None:
    with pytest.raises(InvalidData, match="none of 256 points was exposed"):
        correct_points(raw(raw_scan, exposure_s=np.zeros(256)))


def test_histograms_too_short_for_a_pulse_are_refused() -> None:
    points = RawPoints(np.ones((9, 5)), *np.zeros((2, 9)), np.ones(9), *np.zeros((2, 9)), TimeAxis(5, 32e-12))
    with pytest.raises(InvalidData, match="5 bins are too short"):
        correct_points(points)


def test_a_stray_arrival_late_in_the_record_shortens_no_other_point(raw_scan: RawScan) -> None:
    counts = raw_scan.counts.copy()
    counts[7] = np.roll(counts[7], 150)
    done, undisturbed = correct_points(raw(raw_scan, counts)), correct_points(raw(raw_scan))
    assert done.time.bins == undisturbed.time.bins
    assert done.usable[8].sum() == undisturbed.usable[8].sum()
    assert not done.usable[7, -100:].any()


def test_light_that_only_some_points_recorded_is_counted() -> None:
    scan = make_raw_scan(hidden_counts=100)
    whole = correct_points(raw(scan))
    assert whole.beyond == 0
    ends = int(scan.arrival_bins.max()) + 200  # 2 x 0.96 m behind the last point's direct light
    time = TimeAxis(ends, scan.bin_width_s)
    short = correct_points(replace(raw(scan), counts=scan.counts[:, :ends], time=time))
    last = np.ceil(scan.arrival_bins + short.time.bins).astype(int)
    left_out = sum(row[at:ends].sum() for row, at in zip(scan.hidden, last, strict=True))
    assert left_out > 500
    assert short.beyond == pytest.approx(left_out, abs=5 * np.sqrt(scan.counts.shape[0] * 200 * 0.2))
    dark = make_raw_scan(hidden_counts=0)
    assert correct_points(replace(raw(dark), counts=dark.counts[:, :ends], time=time)).beyond == 0


def test_records_that_end_with_the_direct_light_are_refused(raw_scan: RawScan) -> None:
    latest = int(raw_scan.arrival_bins.max()) + 20
    time = TimeAxis(latest, raw_scan.bin_width_s)
    with pytest.raises(InvalidData, match=r"point \d+ .* direct light arrives in bin .* Lengthen the histogram"):
        correct_points(replace(raw(raw_scan), counts=raw_scan.counts[:, :latest], time=time))


def test_constants_align_a_scan_whose_direct_light_is_gated_out() -> None:
    full, dark = make_raw_scan(), make_raw_scan(direct_counts=0, hidden_counts=400, background=0.005)
    known = measure_constants([raw(full)], devices={}, sources=["full"], measured_utc="2026-01-01T00:00:00+00:00")
    done = correct_points(raw(dark), known.constants)
    brightest = done.counts.argmax(axis=1)
    return_bins = 2 * np.sqrt((dark.x_m - 0.2) ** 2 + dark.y_m**2 + 0.9**2) / 299_792_458 / dark.bin_width_s
    inside = return_bins < done.time.bins - 5
    assert inside.mean() > 0.9
    assert np.abs(brightest - return_bins)[inside].max() < 3
    assert done.report()["arrivals_known"]


@pytest.mark.parametrize(("each", "of_bits"), [(1_000, 16), (40_000, 32), (3_000_000_000, 64)])
def test_passes_over_one_position_are_added_up_whatever_they_hold(each: int, of_bits: int) -> None:
    counts = np.array([0, each, each - 7], np.uint32)
    histogram = Histogram(counts, 16e-12, 0.0, 1.0, 10**9, int(counts.sum(dtype=np.int64)), HistogramFlag.NONE, 0.0)
    places = [(0.1, 0.0), (0.2, 0.0), (0.1, 0.0)]
    samples = [Sample(ScanPoint(n, None, None, *place, 1.0), histogram, 0.0) for n, place in enumerate(places)]
    added = from_samples(samples)
    assert added.counts.tolist() == [[0, 2 * each, 2 * each - 14], [0, each, each - 7]]
    assert added.counts.dtype.itemsize * 8 == of_bits
    assert added.total_count[0] == added.counts[0].sum()


def test_direct_light_of_two_photons_a_pulse_is_timed_with_its_dead_time_and_without_and_doubted_then(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Of each pulse the first photon clicks, earlier where the wall is brighter; drawn from walls of 4 to 100 %."""
    scan = make_raw_scan(direct_counts=2e5, hidden_counts=0, background=1.0)
    pulses, bright = 100_000, np.random.default_rng(2).uniform(0.04, 1.0, (len(scan.x_m), 1))
    left = np.exp(-np.pad(np.cumsum(scan.expected * bright / pulses, axis=1), ((0, 0), (1, 0))))
    clicks = np.random.default_rng(1).poisson(pulses * (left[:, :-1] - left[:, 1:])).astype(np.uint32)
    seen = replace(raw(scan, clicks, np.full(len(clicks), pulses * 100e-9)),
                   sync_count=np.full(len(clicks), pulses), total_count=clicks.sum(axis=1))  # fmt: skip
    known = BenchConstants({}, "2026-01-01", (), scan.bin_width_s, dead_time_s=Quantity(60e-9, 0.0))

    def scatter(constants: BenchConstants | None) -> float:
        offsets = correct_points(seen, constants).offsets
        assert offsets is not None
        return float(np.std(offsets.measured_bins - scan.arrival_bins))

    assert scatter(known) < 0.04
    assert not caplog.messages
    with caplog.at_level(logging.WARNING):
        assert scatter(None) < 0.04
    assert "clicked for 8" in caplog.text
    assert scatter(replace(known, dead_time_s=Quantity(0.0, 0.0))) > 0.08  # as the clicks are
    caplog.clear()
    correct_points(replace(seen, sync_count=seen.sync_count * 20))
    assert "clicked for" not in caplog.text


def test_a_report_says_in_its_units_what_the_scan_was_made_with() -> None:
    told = correct_points(raw(make_raw_scan(direct_counts=40_000))).report()
    assert told["scanner_position_m"] == pytest.approx([0.1, -0.2, 2.0], abs=0.01)
    assert told["electronic_delay_ns"] == pytest.approx(-11, abs=0.05)
    assert told["response_fwhm_ps"] == pytest.approx(70, abs=12)
    assert told["direct_tail_ps"] == pytest.approx(250, rel=0.1)
    assert 0.3 < told["direct_masked_ns"] < 2.5  # type: ignore[operator]  # ends before light from 0.9 m, at 6 ns
    assert told["background_per_bin"] == pytest.approx(0.2, rel=0.1)
    assert told["offset_rms_mm"] == pytest.approx(told["offset_rms_ps"] * 0.149_896, rel=1e-3)  # type: ignore[operator]
    assert told["offset_rms_ps"] == pytest.approx(told["offset_rms_bins"] * 32, rel=1e-6)  # type: ignore[operator]
    assert (told["points"], told["points_without_direct_peak"], told["points_off_the_wall_fit"]) == (256, 0, 0)


@pytest.mark.parametrize("width_ps", [4.0, 40.0])
def test_direct_light_is_looked_for_in_the_first_200_ps_whatever_the_bins(width_ps: float) -> None:
    """Of a Gaussian of 100 ps whose maximum comes at 120 ps."""
    time_ps = (np.arange(round(4000 / width_ps)) + 0.5) * width_ps
    pulse = np.exp(-4 * np.log(2) * ((time_ps - 120) / 100) ** 2)
    aligned = np.random.default_rng(3).poisson(500 * pulse / pulse.max() + 0.5, (50, len(pulse)))
    found = find_direct_light(aligned - 0.5, width_ps * 1e-12)
    assert 180 < found.end_bin * width_ps < 400
    late = find_direct_light(np.roll(aligned, round(600 / width_ps), axis=1) - 0.5, width_ps * 1e-12)
    assert late.end_bin == 0


def test_no_sample_is_no_scan() -> None:
    with pytest.raises(InvalidData, match="not one sample to calibrate from"):
        from_samples([])
