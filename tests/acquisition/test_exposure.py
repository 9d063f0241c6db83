"""Every exposure policy spends the time it was given, where it should."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData, PlanRefused
from nlos.acquisition.planning.exposure import unbiased_live_s
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import Positions
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.engine import record, scan
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.tcspc.counter import HistogramFlag, StopAtCounts

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]


def test_a_budget_is_split_equally_to_the_microsecond(small_plan: Plans) -> None:
    plan = small_plan(5, 7, exposure={"kind": "budget", "total_s": 0.1})
    assert len(set(plan.dwell_s.tolist())) == 1
    assert 0.1 - 35e-6 < plan.dwell_total_s <= 0.1


@pytest.mark.parametrize(
    ("rows", "cols", "dwell_us"), [(6, 6, 113), (7, 7, 1500), (10, 10, 29), (11, 17, 3000), (5, 7, 1)]
)
def test_a_budget_that_comes_to_whole_microseconds_gives_these(
    small_plan: Plans, rows: int, cols: int, dwell_us: int
) -> None:
    """By whole numbers: also where it is all that `dwell_ms` allows, and whatever a quotient is rounded to."""
    total_s = float(Fraction(rows * cols * dwell_us, 1_000_000))
    for longest_us in (dwell_us, 10 * dwell_us):
        budget = {"kind": "budget", "total_s": total_s}
        plan = small_plan(rows, cols, dwell_ms=longest_us / 1e3, exposure=budget)
        assert set(np.round(plan.dwell_s * 1e6, 3).tolist()) == {dwell_us}
    with pytest.raises(PlanRefused, match="more than dwell_ms"):
        small_plan(rows, cols, dwell_ms=dwell_us / 1e3, exposure={"kind": "budget", "total_s": total_s * 1.001})
    with pytest.raises(PlanRefused, match="less than a microsecond"):
        small_plan(rows, cols, exposure={"kind": "budget", "total_s": total_s / dwell_us * 0.999})


def test_a_budget_beyond_need_is_refused(small_plan: Plans) -> None:
    with pytest.raises(PlanRefused, match="more than dwell_ms"):
        small_plan(5, 7, exposure={"kind": "budget", "total_s": 10.0})


@pytest.mark.parametrize("falloff", [2, 4])
def test_dwell_follows_the_distance(small_plan: Plans, falloff: int) -> None:
    target = {"kind": "by_distance", "x_m": 0.3, "y_m": 0.0, "z_m": 0.5, "falloff": falloff}
    plan = small_plan(8, 8, exposure=target)
    distance_m = np.sqrt((plan.positions.x_m - 0.3) ** 2 + plan.positions.y_m**2 + 0.25)
    ratio = plan.dwell_s / distance_m**falloff
    assert np.ptp(ratio) / ratio.mean() < 1e-2
    assert plan.dwell_s.mean() == pytest.approx(0.008, rel=1e-3)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_dwell_follows_a_map_and_zero_leaves_points_out(small_plan: Plans, tmp_path: Path, encoding: str) -> None:
    """Also with the mark that Excel begins a file with."""
    path = tmp_path / "map.csv"
    path.write_text("0,1\n2,3\n", encoding=encoding)
    plan = small_plan(4, 4, exposure={"kind": "by_map", "file": str(path)})
    assert len(plan) == 12
    for point in plan:
        assert point.row is not None
        assert point.col is not None
        assert point.dwell_s == pytest.approx(0.008 / 2 * [[0, 1], [2, 3]][point.row // 2][point.col // 2])


@pytest.mark.parametrize("text", ["1,2\n3\n", "a,b\n", "-1,2\n", "0,0\n", "nan,1\n"])
def test_a_bad_map_is_refused_by_name(small_plan: Plans, tmp_path: Path, text: str) -> None:
    path = tmp_path / "map.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidData, match=r"map\.csv"):
        small_plan(4, 4, exposure={"kind": "by_map", "file": str(path)})


def test_points_stop_at_their_nth_count_and_the_rate_is_unbiased(
    bench_settings: Benches, small_plan: Plans, run_path: Path
) -> None:
    axis = {"bins": 1024, "bin_width_ps": 64, "offset_ns": 10}
    stop = {"kind": "stop_at_counts", "counts": 20, "from_ns": 10.0, "to_ns": 70.0}
    long = small_plan(6, 6, histogram=axis, dwell_ms=100)
    plan = small_plan(6, 6, histogram=axis, dwell_ms=100, exposure=stop)
    with open_bench(bench_settings()) as bench:
        reference = [s.histogram.counts.sum() / s.histogram.live_time_s for s in scan(long, bench)]
        with RecordingWriter.create(run_path, plan, Header()) as writer:
            record(scan(plan, bench), writer)
    with Recording.open(run_path) as recording:
        transient = recording.transient()
        flags = recording.records["flags"]
        live_s = recording.records["live_time_s"]
    assert (flags & HistogramFlag.STOPPED_EARLY != 0).all()
    assert live_s.max() < 0.1
    assert (transient.counts.sum(axis=0) >= 20).all()
    rates = transient.counts.sum(axis=0, dtype=np.float64) / transient.exposure_s
    assert rates.mean() == pytest.approx(np.mean(reference), rel=4 / np.sqrt(20 * 36))


def test_a_rate_by_the_nth_count_is_right_on_average_where_n_is_small() -> None:
    """Waiting times of the third count, drawn count by count: N over them is half as much again."""
    rng, rate_hz = np.random.default_rng(0), 5000.0
    live_s = rng.exponential(1 / rate_hz, (200_000, 3)).sum(axis=1)
    early = np.full(len(live_s), HistogramFlag.STOPPED_EARLY, np.uint16)
    told_s = unbiased_live_s(live_s, early, StopAtCounts(3, 0, 64))
    assert np.mean(3 / told_s) == pytest.approx(rate_hz, rel=0.01)
    assert np.mean(3 / live_s) == pytest.approx(1.5 * rate_hz, rel=0.01)
    assert np.array_equal(unbiased_live_s(live_s, 0 * early, StopAtCounts(3, 0, 64)), live_s)
    assert np.array_equal(unbiased_live_s(live_s, early, None), live_s)


@pytest.mark.parametrize(
    ("from_ns", "to_ns", "bins"), [(16.4, 26.0, (100, 250)), (10.1, 10.7, (1, 11)), (10.0, 75.536, (0, 1024))]
)
def test_points_stop_by_the_bins_that_the_window_touches(
    small_plan: Plans, from_ns: float, to_ns: float, bins: tuple[int, int]
) -> None:
    """Of 64 ps, from 10 ns: (16.4 - 10) / 0.064 = 100."""
    axis = {"bins": 1024, "bin_width_ps": 64, "offset_ns": 10}
    stop = {"kind": "stop_at_counts", "counts": 20, "from_ns": from_ns, "to_ns": to_ns}
    assert small_plan(histogram=axis, exposure=stop).stop == StopAtCounts(20, *bins)


def test_a_stop_window_off_the_time_axis_is_refused(small_plan: Plans) -> None:
    with pytest.raises(PlanRefused, match="not within the histogram"):
        small_plan(exposure={"kind": "stop_at_counts", "counts": 20, "from_ns": 0.0, "to_ns": 15.0})


def test_a_plan_keeps_its_numbers_and_leaves_its_callers_arrays_alone(small_plan: Plans) -> None:
    like = small_plan(4, 4)
    row, col, x_m, y_m, dwell_s, pass_ = (column.copy() for column in like.columns().values())
    plan = ScanPlan(like.wall, like.axis, Positions(row, col, x_m, y_m), dwell_s, pass_, like.stop)
    digest = plan.digest()
    for array in (row, col, x_m, y_m, dwell_s, pass_):
        array += 1
    assert plan.digest() == digest
    for column in plan.columns().values():
        with pytest.raises(ValueError, match="read-only"):
            column += 1


def two_pass(small_plan: Plans, below: int, **extra: Any) -> ScanPlan:
    return small_plan(6, 6, exposure={"kind": "two_pass", "counts": below, "again_ms": 20}, **extra)


@pytest.mark.parametrize(("name", "offset_ns"), [("zero_latency", 10), ("simulated", 10), ("zero_latency", 14)])
def test_the_second_pass_returns_to_the_points_that_fell_short(
    bench_settings: Benches, small_plan: Plans, run_path: Path, name: str, offset_ns: float
) -> None:
    """What lies before the time window, as direct light does before one from 14 ns on, does not count."""
    window = {"histogram": {"bins": 64, "bin_width_ps": 256, "offset_ns": offset_ns}}
    with open_bench(bench_settings(name=name)) as bench:
        first = {s.point.number: int(s.histogram.counts.sum()) for s in scan(small_plan(**window), bench)}
        below = int(np.median(list(first.values())))
        plan = two_pass(small_plan, below, **window)
        with RecordingWriter.create(run_path, plan, Header()) as writer:
            record(scan(plan, bench), writer)
    short = [number for number, counts in first.items() if counts < below]
    assert 5 < len(short) < 31
    with Recording.open(run_path) as recording:
        samples = list(recording.samples())
        assert recording.missing() == []
        assert [s.point.number for s in samples] == [*range(36), *(36 + number for number in short)]
        assert [s.point.dwell_s for s in samples[36:]] == [pytest.approx(0.02)] * len(short)
        exposure_s = recording.transient().exposure_s
    assert sorted(set(np.round(exposure_s.ravel(), 6).tolist())) == [0.008, 0.028]


def test_a_scan_in_two_passes_resumes_in_either(bench_settings: Benches, small_plan: Plans) -> None:
    plan = two_pass(small_plan, 250)
    with open_bench(bench_settings()) as bench:
        whole = list(scan(plan, bench))
        for until in (10, 36, len(whole) - 1):
            taken = {s.point.number: int(s.histogram.counts.sum()) for s in whole[:until]}
            rest = list(scan(plan, bench, taken=taken))
            assert [s.point for s in rest] == [s.point for s in whole[until:]]
            assert np.array_equal([s.histogram.counts for s in rest], [s.histogram.counts for s in whole[until:]])


@pytest.mark.parametrize(("share", "again"), [(0.25, 6), (0.27, 7), (0.01, 1)])
def test_a_second_look_is_had_by_its_share_of_the_points_for_as_long_as_it_says(
    small_plan: Plans, share: float, again: int
) -> None:
    plan = small_plan(5, 5, dwell_ms=2, exposure={"kind": "second_look", "again_ms": 8, "share": share})
    taken = plan.pending({})
    assert taken[:25] == list(range(25))
    assert plan.dwell_s[taken].tolist() == pytest.approx([2e-3] * 25 + [8e-3] * again)
    assert plan.most_samples == 25 + again
