"""A drift of the time zero and a wall that leans: told apart where the order of the points can tell, and else not."""

import re

import numpy as np
import numpy.typing as npt
import pytest
import yaml

from nlos.acquisition.planning.aim import Aim
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.measure import Measurement, measure_constants
from nlos.calibration.raw_points import RawPoints, from_samples
from nlos.cli.calibration_lines import result_lines
from nlos.configs import load
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag
from tests.calibration.conftest import RawScan, make_raw_scan

SIDE, SECONDS = 16, 60.0
AIM = Aim(2.0, 0.0)
SCANNER = {"scanner_m": (0.0, 0.0, 2.0), "delay_s": -11e-9, "direct_counts": 4000.0, "hidden_counts": 0.0}
COURSES = {"even": lambda t: t - 0.5, "settling": lambda t: 1.3 * (np.exp(-2 * t) - 0.5)}
RASTER = np.arange(SIDE**2)
RANDOM = np.random.default_rng(5).permutation(SIDE**2)
ROW, COL = np.divmod(RASTER, SIDE)
SERPENTINE = ROW * SIDE + np.where(ROW % 2 == 1, SIDE - 1 - COL, COL)


def scan(turn: npt.NDArray[np.int64], drift_ps: float, course: str = "even") -> RawPoints:
    """A point's `turn` (N,) of the grid's points says when each was taken."""
    taken = (turn + 0.5) / len(turn)
    made: RawScan = make_raw_scan(SIDE, later_s=drift_ps * 1e-12 * COURSES[course](taken), **SCANNER)  # type: ignore[arg-type]
    ones = np.ones(len(turn))
    time = TimeAxis(made.counts.shape[1], made.bin_width_s)
    return RawPoints(made.counts, made.x_m, made.y_m, 0.1 * ones, 1e6 * ones, made.counts.sum(1).astype(float), time,
                     taken * SECONDS)  # fmt: skip


def calibrated(raw: RawPoints) -> Measurement:
    return measure_constants([raw], devices={}, sources=[], measured_utc="2026-01-01", aim=AIM)


def lean_deg(found: Measurement) -> float:
    assert found.geometry is not None
    geometry = found.geometry.geometry
    return float(np.rad2deg(np.hypot(geometry.wall_pitch_rad, geometry.wall_yaw_rad)))


def said(found: Measurement) -> str:
    return "\n".join(line for line, _ in result_lines(found, None))


@pytest.mark.parametrize("course", list(COURSES))
def test_points_in_random_order_tell_a_drift_from_a_lean(course: str) -> None:
    raw = scan(RANDOM, 200.0, course)
    found = calibrated(raw)
    assert found.drift is not None
    assert found.drift.known
    assert found.drift.significant
    true_ps = 200 * (COURSES[course](1.0) - COURSES[course](0.0))
    assert abs(found.drift.total_s * 1e12 - true_ps) < max(4 * found.drift.error_s * 1e12, 0.03 * abs(true_ps))
    assert lean_deg(found) < 0.05
    assert found.constants.arrivals is not None
    assert np.abs(found.constants.arrivals.residual_s).max() < 15e-12  # of the wall; not of the day
    assert "taken out" in said(found)


@pytest.mark.parametrize("turn", [RASTER, SERPENTINE])
def test_points_in_the_order_of_their_places_do_not_and_calibrate_says_so(turn: npt.NDArray[np.int64]) -> None:
    found = calibrated(scan(turn, 200.0))
    assert lean_deg(found) > 0.3  # what nobody can tell from a drift
    assert found.drift is not None
    assert not found.drift.known
    told = re.search(r"tells \((pattern: .*)\)", said(found))
    assert told is not None
    demo = yaml.safe_load(load.find("scan", "demo").read_text())
    ScanSettings.model_validate({**demo, **yaml.safe_load(told[1])})  # what is told can be done
    assert "cannot tell it from the wall" in said(found)
    per_ps = np.rad2deg(found.drift.like_tilt_rad) / 10
    assert lean_deg(found) == pytest.approx(200 * per_ps, rel=0.1)


@pytest.mark.parametrize("turn", [RASTER, RANDOM])
def test_no_drift_is_found_where_there_is_none(turn: npt.NDArray[np.int64]) -> None:
    found = calibrated(scan(turn, 0.0))
    assert found.drift is not None
    assert not found.drift.significant
    assert lean_deg(found) < 0.05
    assert ("no more than chance" in said(found)) == found.drift.known == (turn is RANDOM)


def test_who_does_not_say_when_the_points_were_taken_is_told_nothing_of_a_drift() -> None:
    raw = scan(RASTER, 0.0)
    without = RawPoints(raw.counts, raw.x_m, raw.y_m, raw.exposure_s, raw.sync_count, raw.total_count, raw.time)
    found = calibrated(without)
    assert found.drift is None
    assert "drift" not in said(found)


def test_points_that_are_visited_again_tell_a_drift_of_a_raster() -> None:
    """Every row of a raster ends with the same reference point."""
    grid = scan(RASTER, 0.0)
    order = np.array([point for row in range(SIDE) for point in (*range(row * SIDE, row * SIDE + SIDE), 0)])
    taken_s = np.linspace(0, SECONDS, len(order))
    later_s = 200e-12 * (taken_s / SECONDS - 0.5)
    again = np.cumsum(order == 0) - 1  # rounds of the wall: of the first all points, of others the reference alone
    samples = []
    for turn in range(again.max() + 1):
        seen = np.flatnonzero((again == turn) & (order == 0)) if turn else np.flatnonzero((again == 0) | (order > 0))
        later = np.zeros(SIDE**2)
        later[order[seen]] = later_s[seen]
        made = make_raw_scan(SIDE, later_s=later, seed=turn, **SCANNER)  # type: ignore[arg-type]
        for number in seen:
            point, at_s = int(order[number]), float(taken_s[number])
            place = ScanPoint(int(number), point // SIDE, point % SIDE, grid.x_m[point], grid.y_m[point], 0.1)
            clicks, none = int(made.counts[point].sum()), HistogramFlag.NONE
            histogram = Histogram(made.counts[point], made.bin_width_s, 0.0, 0.1, 1_000_000, clicks, none, at_s)
            samples.append(Sample(place, histogram, at_s - 0.05))
    raw = from_samples(samples, visits=True)
    assert len(raw.counts) == SIDE**2
    assert raw.visits is not None
    assert len(raw.visits.counts) == len(order)
    found = calibrated(raw)
    assert found.drift is not None
    assert found.drift.significant
    assert found.drift.total_s == pytest.approx(200e-12, abs=15e-12)
    assert lean_deg(found) < 0.06
