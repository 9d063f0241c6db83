"""Points on one line, on a circle or few: direct light is trusted where it agrees with the bench's drawing."""

from dataclasses import replace

import numpy as np
import pytest

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S as C
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.arrival_rounds import TimeOffsets
from nlos.calibration.arrivals import Arrivals
from nlos.calibration.constants import BenchConstants
from nlos.calibration.correct import correct_points
from nlos.calibration.drawn_wall import fit_near_drawing
from nlos.calibration.errors import NoDirectPeak, PoorCalibration
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.measure import measure_constants
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.time_offset import time_offsets_of
from tests.calibration.conftest import RawScan, make_raw_scan

SIDE = 16
CHOSEN = {
    "a row": np.arange(SIDE) + 7 * SIDE,
    "a column": np.arange(SIDE) * SIDE + 5,
    "a diagonal": np.arange(SIDE) * (SIDE + 1),
    "five points": np.array([0, SIDE - 1, SIDE * SIDE // 2 + 8, SIDE * (SIDE - 1), SIDE * SIDE - 1]),
}

FEW = {"two points": np.array([SIDE + 1, 9 * SIDE + 12]), "four points": np.array([0, 40, 100, 7 * SIDE + 7])}


def points_of(scan: RawScan, chosen: np.ndarray, drawn: float | None = 1.04) -> RawPoints:
    """Some of the points, with a drawing that puts the scanner `drawn` times as far away; None: with none."""
    one = np.ones(len(chosen))
    axis = TimeAxis(scan.counts.shape[1], scan.bin_width_s)
    raw = RawPoints(scan.counts[chosen], scan.x_m[chosen], scan.y_m[chosen], one, 0 * one, 0 * one, axis)
    return replace(raw, scanner_m=None if drawn is None else drawn * np.array(scan.scanner_m))


def found(raw: RawPoints) -> TimeOffsets:
    return time_offsets_of(raw, raw.counts)


@pytest.fixture(scope="module")
def outshone() -> RawScan:
    return make_raw_scan(SIDE, direct_counts=150, hidden_counts=1500, background=0.05)


@pytest.mark.parametrize("shape", [*CHOSEN, *FEW])
def test_direct_light_that_hidden_light_outshines_is_found_by_the_drawing(outshone: RawScan, shape: str) -> None:
    chosen = (CHOSEN | FEW)[shape]
    offsets = found(points_of(outshone, chosen))
    assert offsets.on_a_plane == (shape in CHOSEN)
    assert not offsets.off_the_drawing
    assert np.abs(offsets.offset_bins - outshone.arrival_bins[chosen]).max() < 0.5


@pytest.mark.parametrize("shape", CHOSEN)
def test_hidden_light_alone_does_not_agree_with_the_drawing(shape: str) -> None:
    scan = make_raw_scan(SIDE, direct_counts=0, hidden_counts=1500, background=0.005)
    try:
        offsets = found(points_of(scan, CHOSEN[shape]))
    except NoDirectPeak:
        return
    assert offsets.off_the_drawing
    assert not offsets.on_a_plane


@pytest.mark.parametrize("shape", FEW)
def test_few_points_that_the_drawing_does_not_explain_keep_what_is_brightest_and_say_so(shape: str) -> None:
    scan = make_raw_scan(SIDE, scanner_m=(2.0, 0.0, 1.0))
    raw = replace(points_of(scan, FEW[shape]), scanner_m=np.array([-2.0, 0.0, 1.0]))
    assert found(raw).off_the_drawing
    assert np.abs(found(raw).offset_bins - scan.arrival_bins[FEW[shape]]).max() < 1


@pytest.mark.parametrize("shape", CHOSEN)
def test_bright_direct_light_is_kept_where_the_drawing_is_wrong_and_that_is_said(shape: str) -> None:
    scan, chosen = make_raw_scan(SIDE), CHOSEN[shape]
    offsets = found(points_of(scan, chosen, 1.5))
    assert offsets.off_the_drawing
    assert np.abs(offsets.offset_bins - scan.arrival_bins[chosen]).max() < 0.5
    assert correct_points(points_of(scan, chosen, 1.5)).report()["off_the_drawing"]


def test_a_circle_about_the_scanners_axis_is_placed_by_the_drawing_alone() -> None:
    scan = make_raw_scan(SIDE, scanner_m=(0.0, 0.0, 2.0))
    circle = np.flatnonzero(np.isclose(np.hypot(scan.x_m, scan.y_m), np.hypot(7, 9) / SIDE))
    assert len(circle) == 16
    offsets = found(points_of(scan, circle, 1.0))
    assert offsets.on_a_plane
    assert offsets.wall is not None
    np.testing.assert_allclose(offsets.wall.scanner_position_m, scan.scanner_m, atol=0.06)
    with pytest.raises(PoorCalibration, match=f"{len(circle)} points .* nearly one time, as a circle"):
        calibrated(points_of(scan, circle, 1.0))


@pytest.mark.parametrize(("shape", "why"), [("a row", "lie on one line"), ("five points", "are too few")])
def test_no_constants_are_made_of_points_that_do_not_tell_them(outshone: RawScan, shape: str, why: str) -> None:
    with pytest.raises(PoorCalibration, match=f"they {why}.*spans? the wall.*bench file's geometry"):
        calibrated(points_of(outshone, CHOSEN[shape]))


def calibrated(raw: RawPoints) -> None:
    measure_constants([raw], devices={}, sources=["here"], measured_utc="2026-01-01T00:00:00+00:00")


def test_a_scan_that_spans_the_wall_needs_no_drawing(raw_scan: RawScan) -> None:
    everywhere = np.arange(len(raw_scan.counts))
    with_wrong, without = found(points_of(raw_scan, everywhere, 2.0)), found(points_of(raw_scan, everywhere, None))
    np.testing.assert_array_equal(with_wrong.offset_bins, without.offset_bins)


def test_constants_are_believed_before_a_drawing_of_points_that_lie_close_together() -> None:
    """Over a few centimetres a hidden object's light comes as a wall's would."""
    scan = make_raw_scan(SIDE, wall_m=0.15, direct_counts=0, hidden_counts=1500, background=0.005)
    raw = points_of(scan, CHOSEN["a row"], 1.0)
    arrivals = Arrivals(
        np.array(scan.scanner_m), scan.delay_s, np.eye(4), 1e-12, scan.x_m, scan.y_m, np.zeros(len(scan.x_m))
    )
    known = BenchConstants({}, "2026-01-01T00:00:00+00:00", ("here",), scan.bin_width_s, arrivals=arrivals)
    assert correct_points(raw, known).offsets is None


def test_the_drawing_puts_the_scanner_where_its_beam_comes_from() -> None:
    """At equal angles to a wall that leans, by the lengths of two beams and the ground between them."""
    drawn = ScannerGeometry(2.0, scanner_x_m=0.3, scanner_y_m=-0.1, wall_pitch_rad=0.2, wall_yaw_rad=-0.3)
    x_m, y_m, range_m = drawn.spots([-0.2, 0.1, 0.25], [0.1, -0.2, 0.15])
    right, up, off = drawn.scanner_m
    assert off > 0
    np.testing.assert_allclose(np.sqrt((x_m - right) ** 2 + (y_m - up) ** 2 + off**2), range_m, rtol=1e-12)


@pytest.mark.parametrize("scatter", [0.0, 6.0])
def test_the_place_is_where_arrivals_and_drawing_agree_best_and_its_errors_are_theirs(scatter: float) -> None:
    x, error_s, drawn = np.linspace(-0.5, 0.5, SIDE), 2e-12, np.array([0.22, 0.12, 1.52])
    way_m = np.sqrt((x - 0.2) ** 2 + 0.1**2 + 1.5**2)
    arrival_s = 3e-9 + 2 * way_m / C + scatter * error_s * np.random.default_rng(1).normal(size=SIDE)
    found = fit_near_drawing(arrival_s, np.full(SIDE, error_s), x, 0 * x, drawn)
    assert found is not None
    assert found.accepted.all()

    def off(p: np.ndarray) -> np.ndarray:
        there_s = p[3] + 2 * np.sqrt((x - p[0]) ** 2 + p[1] ** 2 + p[2] ** 2) / C
        errors_s = np.sqrt(2) * error_s  # each arrival's own and the median one
        return np.append((there_s - arrival_s) / errors_s, (p[:3] - drawn) / (0.03 * np.linalg.norm(drawn)))

    at = np.append(found.scanner_position_m, found.delay_s)
    steps = np.diag([1e-6, 1e-6, 1e-6, 1e-14])
    slopes = np.stack([(off(at + step) - off(at - step)) / (2 * step.sum()) for step in steps], axis=1)
    alone = np.linalg.inv(slopes.T @ slopes)
    assert (np.abs(alone @ slopes.T @ off(at)) < 0.01 * np.sqrt(np.diag(alone))).all()
    chance = max(np.mean(off(at)[:SIDE] ** 2), 1.0)
    assert (chance > 2) == (scatter > 0)
    scale = np.sqrt(np.outer(np.diag(alone), np.diag(alone)))
    assert found.covariance / scale == pytest.approx(alone * chance / scale, abs=1e-3)


@pytest.mark.parametrize(("off", "found_off"), [(2.9, 2.9), (4.0, 3.0)])
def test_a_scanner_is_looked_for_within_three_errors_of_a_tape(off: float, found_off: float) -> None:
    x, y = (each.ravel() for each in np.meshgrid(*[np.linspace(-0.5, 0.5, SIDE)] * 2))
    away_m = 1.5 * (1 + 0.03 * off)
    error_s = np.full(len(x), 1e-13)
    found = fit_near_drawing(2 * np.sqrt(x**2 + y**2 + away_m**2) / C, error_s, x, y, (0.0, 0.0, 1.5))
    assert found is not None
    assert found.scanner_position_m == pytest.approx([0.0, 0.0, 1.5 * (1 + 0.03 * found_off)], abs=1e-4)
