"""Continuous lines put the beam on each point in the middle of its dwell, although the mirror never settles."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.planning.schemes import Scheme, choose, forecast
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.engine import scan
from nlos.acquisition.scanning.sweeping import Lines, line_length, sweep
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.errors import LimitError
from nlos.drivers.simulated.faults import Fault

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]
WALL = {"width_m": 0.3, "height_m": 0.3, "rows": 24, "cols": 24}
LAG_MS = 0.24
"""By how much the simulated head trails a ramp, as measured on it."""


def fast_plan(small_plan: Plans, **overrides: Any) -> ScanPlan:
    return small_plan(24, 24, **{"wall": WALL, "dwell_ms": 0.2, "continuous": {"lag_ms": LAG_MS}, **overrides})


def beam_at_edges(bench: Bench) -> list[tuple[float, float]]:
    """Fills, edge by edge of the clock, with where on the wall the beam is."""
    seen: list[tuple[float, float]] = []
    simulated = bench.simulated
    assert simulated is not None
    aim = aim_of(bench)
    simulated.wire("pixel_clock", lambda when_s: seen.append(aim.wall_point(simulated.beam_at(when_s))))
    return seen


@pytest.mark.parametrize("pattern", ["serpentine", "raster"])
def test_the_beam_crosses_every_point_in_the_middle_of_its_dwell(
    bench_settings: Benches, small_plan: Plans, pattern: str
) -> None:
    plan = fast_plan(small_plan, pattern=pattern)
    with open_bench(bench_settings()) as bench:
        angles = checked_angles(plan, bench, aim_of(bench))
        made = sweep(list(plan), angles, bench.mirror.settle_s, 1200, False, Lines(plan, angles, LAG_MS * 1e-3))
        edges = beam_at_edges(bench)
        samples = list(scan(plan, bench, scheme=Scheme.SWEPT))
    assert [sample.point for sample in samples] == list(plan)
    assert made.count == len(plan)
    measuring = np.array([entry for entry, index in enumerate(made.index) if index >= 0][:-1])
    crossed = (np.array(edges)[measuring] + np.array(edges)[measuring + 1]) / 2
    wanted = np.stack([plan.positions.x_m, plan.positions.y_m], axis=1)[:-1]
    assert np.hypot(*(crossed - wanted).T).max() < 0.25 * 0.3 / 24


def test_lines_are_swept_where_that_is_faster_and_the_plan_allows_it(
    bench_settings: Benches, small_plan: Plans
) -> None:
    with open_bench(bench_settings(name="simulated")) as bench:
        for plan, scheme in [
            (fast_plan(small_plan), Scheme.SWEPT),
            (small_plan(24, 24, wall=WALL, dwell_ms=0.2), Scheme.CLOCKED),
            (fast_plan(small_plan, dwell_ms=8), Scheme.CLOCKED),
        ]:
            choice = choose(plan, bench, checked_angles(plan, bench, aim_of(bench)))
            assert choice.scheme is scheme
            started_s = bench.clock.now()
            assert len(list(scan(plan, bench))) == len(plan)
            assert choice.forecast.total_s == pytest.approx(bench.clock.now() - started_s, rel=0.05)
        plan = fast_plan(small_plan)
        angles = checked_angles(plan, bench, aim_of(bench))
        swept, settled = (forecast(s, plan, bench, angles).total_s for s in (Scheme.SWEPT, Scheme.CLOCKED))
        assert swept < 0.7 * settled


def test_photons_listed_one_by_one_are_swept_too(bench_settings: Benches, small_plan: Plans) -> None:
    plan = fast_plan(small_plan, histogram={"bins": 512, "bin_width_ps": 40, "offset_ns": 10}, dwell_ms=1)
    with open_bench(bench_settings(name="multiharp")) as bench:
        samples = list(scan(plan, bench, scheme=Scheme.SWEPT))
    assert [sample.point for sample in samples] == list(plan)


def test_a_lost_step_is_noticed_on_the_way(bench_settings: Benches, small_plan: Plans) -> None:
    plan = fast_plan(small_plan)
    results = []
    for faults in ([], [Fault(name="A6", skip=300, parameters={"kind": "missed"})]):
        with open_bench(bench_settings(*faults)) as bench:
            results.append([s.histogram.counts for s in scan(plan, bench, scheme=Scheme.SWEPT)])
    assert np.array_equal(*results)


def test_a_line_begun_in_the_middle_is_swept_whole(bench_settings: Benches, small_plan: Plans) -> None:
    plan = fast_plan(small_plan)
    with open_bench(bench_settings()) as bench:
        whole = list(scan(plan, bench, scheme=Scheme.SWEPT))
        taken = {number: 0 for number in range(len(plan)) if number < 100 or number % 7 == 0}
        rest = list(scan(plan, bench, scheme=Scheme.SWEPT, taken=taken))
    expected = [sample for sample in whole if sample.point.number not in taken]
    assert [s.point for s in rest] == [s.point for s in expected]
    assert np.array_equal([s.histogram.counts for s in rest], [s.histogram.counts for s in expected])


def test_a_plan_that_states_no_lag_or_stops_at_counts_is_not_swept(bench_settings: Benches, small_plan: Plans) -> None:
    with open_bench(bench_settings()) as bench, pytest.raises(ValueError, match="states no lag"):
        scan(small_plan(), bench, scheme=Scheme.SWEPT)
    stop = {"kind": "stop_at_counts", "counts": 20, "from_ns": 11.0, "to_ns": 15.0}
    with pytest.raises(PlanRefused, match="uneven pace"):
        fast_plan(small_plan, exposure=stop)


def test_a_run_up_beyond_the_mirrors_reach_is_refused_before_anything_moves(
    bench_settings: Benches, small_plan: Plans
) -> None:
    wall = {"width_m": 3.3, "height_m": 1.0, "rows": 2, "cols": 64}
    plan = small_plan(wall=wall, dwell_ms=0.35, continuous={"lag_ms": LAG_MS})
    with open_bench(bench_settings()) as bench:
        angles = checked_angles(plan, bench, aim_of(bench))
        with pytest.raises(LimitError, match="outside"):
            scan(plan, bench, scheme=Scheme.SWEPT)
        choice = choose(plan, bench, angles)
    assert choice.scheme is Scheme.CLOCKED
    assert "not in continuous lines: mirror x" in choice.why


def test_a_line_faster_than_the_mirror_is_refused(bench_settings: Benches, small_plan: Plans) -> None:
    plan = small_plan(4, 24, dwell_ms=0.1, continuous={"lag_ms": LAG_MS})
    with open_bench(bench_settings()) as bench, pytest.raises(LimitError, match=r"cannot follow a line in 2\.4 ms"):
        scan(plan, bench, scheme=Scheme.SWEPT)


def test_a_recording_keeps_that_its_lines_were_continuous(small_plan: Plans, run_path: Any) -> None:
    plan = fast_plan(small_plan)
    RecordingWriter.create(run_path, plan, Header()).finish(1)  # type: ignore[arg-type]
    with Recording.open(run_path) as recording:
        assert recording.plan == plan
        assert recording.plan.lag_s == pytest.approx(LAG_MS * 1e-3)


def test_lines_end_where_steps_or_dwells_change() -> None:
    place = np.array([(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (2, 1), (1, 1)], dtype=float)
    dwells = np.ones(7)
    assert line_length(place, dwells) == 4
    assert line_length(place[3:], dwells[3:]) == 2
    assert line_length(place[4:], dwells[4:]) == 3
    assert line_length(place[:1], dwells[:1]) == 1
    assert line_length(place, np.array([1.0, 1.0, 2.0, 1.0, 1.0, 1.0, 1.0])) == 2
    assert line_length(place, np.array([1.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0])) == 1
