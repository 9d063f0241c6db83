from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.calibration.arrival_rounds import TimeOffsets
from nlos.calibration.errors import NoDirectPeak, ShutterClosed
from nlos.calibration.impulse_response import from_histogram, stack
from nlos.calibration.time_offset import measure_time_offsets
from nlos.calibration.wall_timing import fit_wall_timing
from tests.calibration.conftest import RawScan, make_raw_scan

SHARED = Path(__file__).parents[3] / "shared" / "data"
needs_shared = pytest.mark.skipif(not SHARED.exists(), reason="../shared is not here")


def measure(scan: RawScan, **more: object) -> TimeOffsets:
    axis = TimeAxis(scan.counts.shape[1], scan.bin_width_s)
    return measure_time_offsets(scan.counts, scan.x_m, scan.y_m, axis, **more)  # type: ignore[arg-type]


def rms(off: np.ndarray) -> float:
    return float(np.sqrt(np.mean((off - off.mean()) ** 2)))


@pytest.mark.parametrize(("points", "bins"), [(1, 30), (7, 60), (2500, 90)])
def test_stacked_histograms_are_those_read_one_by_one_between_the_bins(points: int, bins: int) -> None:
    rng = np.random.default_rng(points)
    counts = rng.poisson(0.5, (points, bins)).astype(np.uint32)
    arrivals = rng.uniform(-20, bins + 20, points)  # some off the record
    arrivals[0] = 12.0
    steps = np.arange(4 * 25 + 1) / 4 - 5
    running = np.pad(np.cumsum(counts, axis=1), ((0, 0), (1, 0))).astype(float)
    each = [np.interp(at + steps, np.arange(bins + 1), row) for at, row in zip(arrivals, running, strict=True)]
    np.testing.assert_allclose(
        stack(counts, np.arange(len(counts)), arrivals, (5, 20), 4), np.diff(np.sum(each, axis=0)), rtol=0, atol=1e-8
    )


def test_offsets_are_found_to_a_fraction_of_a_bin(raw_scan: RawScan) -> None:
    assert rms(measure(raw_scan).offset_bins - raw_scan.arrival_bins) < 0.05


def test_the_direct_arrival_is_the_maximum_of_the_pulse(raw_scan: RawScan) -> None:
    assert abs(np.mean(measure(raw_scan).offset_bins - raw_scan.arrival_bins)) < 0.3


def test_scanner_and_delay_lie_within_their_errors(raw_scan: RawScan) -> None:
    time_s = 4e-12 * np.arange(-30, 31)
    pulse = np.exp(-4 * np.log(2) * (time_s / 70e-12) ** 2)  # 70 ps wide at half its height
    wall = measure(raw_scan, response=from_histogram(pulse, 4e-12)).wall
    assert wall is not None
    error_m = np.sqrt(np.diag(wall.covariance)[:3])
    assert (np.abs(wall.scanner_position_m - raw_scan.scanner_m) < 4 * error_m).all()
    assert error_m[2] < 0.02


def test_the_errors_of_a_walls_fit_are_the_spread_of_many_fits() -> None:
    """Of arrivals with a known scatter: place in metres, delay in seconds, there and back."""
    rng, scatter_s = np.random.default_rng(1), 20e-12
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.8, 0.8, 12)] * 2))
    truth = np.array([0.2, -0.1, 1.5, 3e-9])
    exact = truth[3] + 2 * np.linalg.norm(np.stack([x, y, 0 * x], axis=1) - truth[:3], axis=1) / 299_792_458
    fits = []
    for _ in range(60):
        fit = fit_wall_timing(exact + rng.normal(0, scatter_s, len(x)), np.full(len(x), scatter_s), x, y)
        assert fit is not None
        fits.append(fit)
    places = np.array([[*fit.scanner_position_m, fit.delay_s] for fit in fits])
    said = np.sqrt(np.mean([np.diag(fit.covariance) for fit in fits], axis=0))
    assert (np.abs(places.mean(axis=0) - truth) < 4 * said / np.sqrt(len(fits))).all()
    assert places.std(axis=0) == pytest.approx(said, rel=0.35)
    assert np.mean([fit.rms_s for fit in fits]) == pytest.approx(scatter_s, rel=0.05)


@pytest.mark.parametrize("side", [4, 9, 16])
@pytest.mark.parametrize("scatter_s", [0.0, 1e-15, 1e-13])
def test_times_that_are_alike_at_all_points_tell_no_wall(side: int, scatter_s: float) -> None:
    """Whatever the rounding: a search that was broken off on its way had been taken for a wall 16 m away."""
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.9, 0.9, side)] * 2))
    for seed in range(5):
        rng = np.random.default_rng(seed)
        times_s = 1e-9 + rng.normal(0, scatter_s, len(x)) + rng.normal(0, 1e-18, len(x))
        assert fit_wall_timing(times_s, np.full(len(x), 1e-13), x, y) is None


def test_the_delay_counts_from_the_sync_wherever_the_record_starts(raw_scan: RawScan) -> None:
    parts = (raw_scan.counts, raw_scan.x_m, raw_scan.y_m)
    early = measure_time_offsets(*parts, TimeAxis(512, raw_scan.bin_width_s)).wall
    late = measure_time_offsets(*parts, TimeAxis(512, raw_scan.bin_width_s, 5e-9)).wall
    assert early is not None
    assert late is not None
    assert late.delay_s - early.delay_s == pytest.approx(5e-9, abs=1e-12)


def test_points_of_few_photons_lean_on_the_wall() -> None:
    scan = make_raw_scan(direct_counts=15, hidden_counts=0.5, background=0.002)
    found = measure(scan)
    assert rms(found.offset_bins - scan.arrival_bins) < 0.2
    assert rms(found.offset_bins - scan.arrival_bins) < rms(
        found.measured_bins[found.found] - scan.arrival_bins[found.found]
    )


def test_outliers_are_bridged() -> None:
    scan = make_raw_scan()
    counts = scan.counts.copy()
    for point in (7, 100, 101, 200):  # a glint from the room, brighter than the wall, 40 bins early
        counts[point, int(scan.arrival_bins[point]) - 40] += 3 * counts[point].max()
    axis = TimeAxis(512, scan.bin_width_s)
    found = measure_time_offsets(counts, scan.x_m, scan.y_m, axis)
    off = found.offset_bins - scan.arrival_bins
    assert np.abs(off - np.median(off)).max() < 0.5


def test_a_step_in_the_wall_is_kept() -> None:
    scan = make_raw_scan()
    step = (scan.x_m > 0.7) & (scan.y_m > 0.7)
    counts = scan.counts.copy()
    counts[step] = np.roll(counts[step], -30, axis=1)
    found = measure_time_offsets(counts, scan.x_m, scan.y_m, TimeAxis(512, scan.bin_width_s))
    off = found.offset_bins - scan.arrival_bins + 30 * step
    assert np.abs(off - np.median(off)).max() < 0.5


def test_a_pulse_before_the_record_is_placed_by_the_wall_and_not_at_its_tail() -> None:
    scan = make_raw_scan(delay_s=-13.6e-9, scanner_m=(0.1, -0.2, 2.0))
    missed = scan.arrival_bins < -2
    assert 3 < missed.sum() < 60
    off = measure(scan).offset_bins - scan.arrival_bins
    assert np.abs(off - np.median(off))[missed].max() < 0.5


def test_points_without_exposure_get_the_walls_prediction(raw_scan: RawScan) -> None:
    counts, exposed = raw_scan.counts.copy(), np.ones(len(raw_scan.counts), bool)
    exposed[5:9] = False
    counts[5:9] = 0
    axis = TimeAxis(512, raw_scan.bin_width_s)
    found = measure_time_offsets(counts, raw_scan.x_m, raw_scan.y_m, axis, exposed=exposed)
    assert not found.found[5:9].any()
    assert rms(found.offset_bins - raw_scan.arrival_bins) < 0.05


def test_a_closed_shutter_is_told_apart() -> None:
    dark = np.random.default_rng(0).poisson(0.05, (30, 512))
    with pytest.raises(ShutterClosed, match=r"all 30 points hold .* no laser light"):
        measure_time_offsets(dark, np.arange(30) % 6, np.arange(30) // 6, TimeAxis(512, 32e-12))


def test_light_without_a_direct_peak_is_told_with_its_point() -> None:
    slow = np.random.default_rng(0).poisson(2 + np.sin(np.arange(512) / 80), (30, 512))
    with pytest.raises(NoDirectPeak, match=r"\d+ points is \d\.\d ns wide, too slow"):
        measure_time_offsets(slow, np.arange(30) % 6, np.arange(30) // 6, TimeAxis(512, 32e-12))


@pytest.mark.parametrize("points", [1, 4, 8])
def test_few_points_are_measured_without_a_wall(points: int) -> None:
    scan = make_raw_scan(side=4)
    axis = TimeAxis(512, scan.bin_width_s)
    found = measure_time_offsets(scan.counts[:points], scan.x_m[:points], scan.y_m[:points], axis)
    assert found.wall is None
    assert np.abs(found.offset_bins - scan.arrival_bins[:points]).max() < 0.5


@needs_shared
def test_the_measured_scan_is_rectified_to_half_a_bin() -> None:
    with h5py.File(SHARED / "real" / "rawscan_semisynth_s_u.h5") as file:
        counts, exact = file["histograms"][:], file["time_offset_bins"][:].ravel()
        scanner = file.attrs["scanner_position_m"]
    check_raw_scan(counts, exact, scanner, 0.5)


@needs_shared
def test_two_percent_of_its_photons_suffice_for_one_and_a_half_bins() -> None:
    with h5py.File(SHARED / "real" / "rawscan_semisynth_s_u.h5") as file:
        exact, scanner = file["time_offset_bins"][:].ravel(), file.attrs["scanner_position_m"]
    check_raw_scan(np.load(SHARED / "tcspc" / "replay_s_u_expected.npz")["histograms"], exact, scanner, 1.5)


def check_raw_scan(counts: np.ndarray, exact: np.ndarray, scanner: np.ndarray, limit_bins: float) -> None:
    x, y = np.meshgrid(WallGrid(0.7, 0.7, 64, 64).x_m(), WallGrid(0.7, 0.7, 64, 64).y_m())
    found = measure_time_offsets(counts.reshape(4096, -1), x.ravel(), y.ravel(), TimeAxis(4096, 4e-12))
    off = found.offset_bins - exact
    assert rms(off) <= limit_bins
    assert np.abs(off - off.mean()).max() <= 3
    assert found.wall is not None
    assert np.linalg.norm(found.wall.scanner_position_m - scanner) < 0.02


def test_a_wall_is_found_again_from_where_it_was() -> None:
    """Whatever explains only some of the points is no place to begin from."""
    draw = np.random.default_rng(5)
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.5, 0.5, 12), np.linspace(-0.5, 0.5, 12)))
    distance = np.sqrt((x - 0.2) ** 2 + (y + 0.1) ** 2 + 1.3**2)
    arrival = 5e-9 + 2 * distance / SPEED_OF_LIGHT_M_PER_S + draw.normal(0, 5e-12, len(x))
    error = np.full(len(x), 5e-12)
    first = fit_wall_timing(arrival, error, x, y)
    assert first is not None
    again = fit_wall_timing(arrival, error, x, y, first)
    assert again is not None
    np.testing.assert_allclose(again.scanner_position_m, first.scanner_position_m, atol=1e-6)
    assert again.delay_s == pytest.approx(first.delay_s, abs=1e-14)
    elsewhere = replace(first, scanner_position_m=np.array([40.0, 40.0, 0.1]), accepted=np.arange(len(x)) < len(x) // 2)
    found = fit_wall_timing(arrival, error, x, y, elsewhere)
    assert found is not None
    np.testing.assert_array_equal(found.scanner_position_m, first.scanner_position_m)


def gated(suppressed: float) -> tuple[np.ndarray, np.ndarray]:
    """Photons of the measured scan whose direct light a gated detector suppressed, (N, T), and the exact arrivals."""
    with h5py.File(SHARED / "real" / "rawscan_semisynth_s_u.h5") as file:
        counts, exact = file["histograms"][:].reshape(4096, -1).astype(np.int64), file["time_offset_bins"][:].ravel()
    after = np.arange(counts.shape[1]) - exact[:, None]
    direct = (after > -100) & (after < 2.5e-9 / 4e-12)
    counts[direct] = np.random.default_rng(0).binomial(counts[direct], suppressed)
    return counts, exact


@needs_shared
def test_direct_light_that_a_gated_detector_suppressed_is_found_before_the_hidden_light() -> None:
    counts, exact = gated(0.001)  # 12 photons a point, beside 1,273 of what is hidden
    check_raw_scan(counts, exact, np.array([0.12, -0.35, 1.15]), 0.5)


@needs_shared
def test_hidden_light_alone_is_not_taken_for_direct_light() -> None:
    counts, _ = gated(0.0)
    x, y = np.meshgrid(WallGrid(0.7, 0.7, 64, 64).x_m(), WallGrid(0.7, 0.7, 64, 64).y_m())
    with pytest.raises(NoDirectPeak, match=r"hidden object's light, and direct light is missing.*--constants"):
        measure_time_offsets(counts, x.ravel(), y.ravel(), TimeAxis(4096, 4e-12))


@pytest.mark.parametrize("direct_counts", [40, 8])
def test_direct_light_is_the_earliest_where_a_hidden_object_outshines_it(direct_counts: float) -> None:
    scan = make_raw_scan(direct_counts=direct_counts, hidden_counts=400, background=0.005)
    found = measure(scan)
    assert found.on_a_plane
    assert np.abs(found.offset_bins - scan.arrival_bins).max() < 0.5


def test_a_reflection_that_is_early_at_one_time_everywhere_is_no_wall() -> None:
    """Of a lens, say: it stands still while the beam moves over the wall."""
    scan = make_raw_scan(direct_counts=0, hidden_counts=400, background=0.005)
    counts = scan.counts.copy()
    counts[:, 30:32] += np.random.default_rng(1).poisson(20, (len(counts), 2)).astype(np.uint32)
    axis = TimeAxis(512, scan.bin_width_s)
    assert not measure_time_offsets(counts, scan.x_m, scan.y_m, axis).on_a_plane


@pytest.mark.parametrize(("direct_counts", "tail_share"), [(30, 0.97), (40, 0.9)])
def test_a_few_photons_of_a_steep_rise_and_a_slow_fall_are_as_unsure_as_they_say(
    direct_counts: float, tail_share: float
) -> None:
    """Their log-likelihood is no parabola at its maximum."""
    scan = make_raw_scan(
        side=20, direct_counts=direct_counts, hidden_counts=0.5, background=0.01, tail_share=tail_share
    )
    found = measure(scan)
    off = found.measured_bins - scan.arrival_bins
    off -= np.median(off[found.found])
    assert np.sqrt(np.mean((off / found.error_bins)[found.found & ~found.stray] ** 2)) < 1.12
    assert rms(found.offset_bins - scan.arrival_bins) < 0.1


@pytest.mark.parametrize("fwhm_s", [70e-12, 600e-12])
def test_the_maximum_of_a_slow_pulse_is_not_its_highest_bin(fwhm_s: float) -> None:
    """About the top many fine steps are as high but for chance, and time 0 would be wherever that puts it."""
    at = np.arange(2000) * 2e-12
    pulse = np.exp(-4 * np.log(2) * ((at - 1.5e-9) / fwhm_s) ** 2)
    random = np.random.default_rng(4)
    found_s = [-from_histogram(random.poisson(p), 2e-12).start_s for p in np.tile(3e4 * pulse / pulse.sum(), (20, 1))]
    np.testing.assert_allclose(found_s, 1.5e-9 + 1e-12, atol=0.06 * fwhm_s)


@pytest.mark.parametrize("seed", [12, 15, 19])
def test_direct_light_of_a_slow_detector_is_found_in_fine_bins(seed: int) -> None:
    scan = make_raw_scan(
        6, wall_m=0.5, bins=2600, bin_width_s=4e-12, scanner_m=(0.0, 0.1, 0.7), delay_s=-2.5e-9, fwhm_s=700e-12,
        direct_counts=20_000, tail_share=0.0, background=2.0, depth_m=0.6, hidden_counts=8_000, seed=seed,
    )  # fmt: skip
    found = measure(scan)
    assert found.found.all()
    assert rms(found.offset_bins - scan.arrival_bins) * scan.bin_width_s < 8e-12
