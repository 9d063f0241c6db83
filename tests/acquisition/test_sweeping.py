"""Continuous lines put the beam on each point in the middle of its dwell, although the mirror never settles."""

import math
import re
from collections.abc import Callable
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning import schemes
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.planning.schemes import Scheme, choose, continuous_lines, forecast
from nlos.acquisition.recording.layout import event_row
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning import lag_trial
from nlos.acquisition.scanning.alarms import Action, AlarmRaised, Alarms, AlarmSettings
from nlos.acquisition.scanning.clocked import Stepping
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.acquisition.scanning.engine import scan
from nlos.acquisition.scanning.lag import Lag
from nlos.acquisition.scanning.sweeping import Lines, append_line, line_length, sweep
from nlos.calibration.geometry import ScannerGeometry
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.bench_settings import AllowedArea
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles, axes_rad
from nlos.drivers.galvo.settle import SettleModel
from nlos.drivers.simulated.bench import Gate
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.servo import ServoSettings

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]
WALL = {"width_m": 0.5, "height_m": 0.5, "rows": 24, "cols": 24}
KNOWN = Lag(0.12e-3, 0.1)
"""About what the simulated head has at this speed."""


def fast_plan(small_plan: Plans, **overrides: Any) -> ScanPlan:
    histogram = {"bins": 256, "bin_width_ps": 32, "offset_ns": 10}
    return small_plan(24, 24, **{"wall": WALL, "dwell_ms": 0.2, "continuous": {}, "histogram": histogram, **overrides})


@pytest.fixture
def bright(bench_settings: Benches) -> Benches:
    """bright(*faults, name=..., servo={}, direct_cps=...): a bench in front of a bare wall, which is quickly drawn."""

    def make(*faults: Fault, servo: dict[str, float] | None = None, direct_cps: float = 300e3, **options: Any) -> Any:
        settings = bench_settings(*faults, **options)
        assert settings.simulation is not None
        scene = settings.simulation.scene.model_copy(update={"objects": (), "direct_cps": direct_cps})
        changes = {"servo": ServoSettings(**(servo or {})), "scene": scene}
        return settings.model_copy(update={"simulation": settings.simulation.model_copy(update=changes)})

    return make


def swept(plan: ScanPlan, bench: Bench, **options: Any) -> tuple[list[Sample], float, Lag]:
    """(samples, how far from its point the beam was at worst, in pixels, what was found out about the lag)"""
    assert bench.simulated is not None
    aim, seen, lags = aim_of(bench), dict[int | None, tuple[float, float]](), list[Lag]()
    bench.on_event = lambda kind, text: lags.append(Lag.of_text(text)) if kind == "lag" else None
    bench.simulated.on_gate = lambda gate, beam: seen.__setitem__(gate.number, aim.wall_point(beam))
    samples = list(scan(plan, bench, scheme=Scheme.SWEPT, **options))
    bench.simulated.on_gate = None
    pitch_m = plan.wall.width_m / plan.wall.cols
    points = [sample.point for sample in samples]
    off = max(np.hypot(seen[p.number][0] - p.x_m, seen[p.number][1] - p.y_m) for p in points) / pitch_m
    return samples, float(off), lags[-1]


@pytest.mark.parametrize("by", ["an alarm", "a signal"])
def test_no_lag_is_measured_where_a_pause_is_wanted_before_the_light(
    bright: Benches, small_plan: Plans, by: str
) -> None:
    """The measurement needs light, which nobody may have then."""
    events: list[tuple[str, str]] = []
    settings = AlarmSettings(max_dark_hz=1.0 if by == "an alarm" else None, on_dark_rate=Action.PAUSE)
    control = ScanControl()
    with open_bench(bright()) as bench:
        bench.on_event = lambda kind, text: events.append((kind, text))
        alarms = Alarms(settings, bench.settings.laser.repetition_hz)
        samples = scan(fast_plan(small_plan), bench, scheme=Scheme.SWEPT, control=control, alarms=alarms)
        if by == "a signal":
            bench.shutter.hold("SIGINT")
            control.interrupt()
            assert list(samples) == []
        else:
            with pytest.raises(AlarmRaised, match="dark counts"):
                list(samples)
    assert ("shutter", "opened") not in events


@pytest.mark.sampled(3)
@pytest.mark.parametrize("pattern", ["serpentine", "raster"])
@pytest.mark.parametrize("servo", [{}, {"bandwidth_hz": 1200.0, "delay_us": 60.0}])
def test_the_beam_crosses_every_point_in_the_middle_of_its_dwell(
    bright: Benches, small_plan: Plans, pattern: str, servo: dict[str, float]
) -> None:
    plan = fast_plan(small_plan, pattern=pattern)
    with open_bench(bright(servo=servo)) as bench:
        samples, off_px, lag = swept(plan, bench)
    assert [sample.point for sample in samples] == list(plan)
    assert off_px <= lag.within_px <= 0.25


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "servo",
    [{"bandwidth_hz": 150.0}, {"slew_deg_per_s": 1000.0}, {"slew_deg_per_s": 1450.0}],
    ids=["too narrow a band", "too slow", "too slow in the middle of a line"],
)
def test_a_mirror_that_does_not_follow_is_found_out_and_refused(
    bright: Benches, small_plan: Plans, servo: dict[str, float]
) -> None:
    plan = fast_plan(small_plan)
    with open_bench(bright(servo=servo)) as bench:
        with pytest.raises(LimitError, match=r"within .* pixels of its points after \d+ sequences|its table says"):
            list(scan(plan, bench, scheme=Scheme.SWEPT))
        assert bench.simulated is not None
        assert not bench.simulated.shutter_open


def test_without_light_from_the_wall_nothing_is_swept(bright: Benches, small_plan: Plans) -> None:
    with open_bench(bright(direct_cps=0.0)) as bench, pytest.raises(LimitError, match="Let more light from the wall"):
        list(scan(fast_plan(small_plan), bench, scheme=Scheme.SWEPT))


@pytest.mark.parametrize(
    "changes", [{"direct_cps": 4e3}, {"servo": {"slew_deg_per_s": 1000.0}}], ids=["light", "mirror"]
)
def test_lines_whose_lag_cannot_be_measured_are_taken_point_by_point(
    bright: Benches, small_plan: Plans, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any]
) -> None:
    """Where nobody asked for lines by name; a scan that is resumed does so, too, without light for a measurement."""
    monkeypatch.setattr(schemes, "USUAL", 0)  # else so small a scan is not worth the measurement
    plan, events, control = fast_plan(small_plan), list[tuple[str, str]](), ScanControl()
    with open_bench(bright(**changes)) as bench:
        bench.on_event = lambda kind, text: events.append((kind, text))
        began_s = bench.clock.now()
        samples = list(scan(plan, bench, control=control))
        took_s = bench.clock.now() - began_s
    kinds = [kind for kind, _ in events]
    told = dict(events)
    assert kinds[:5] == ["scheme", "shutter", "shutter", "lag", "scheme"]
    assert events[2][1] == "closed: lines that are not swept"
    assert re.search(r"not in continuous lines: .*the beam trails by .* ms .* \d+ sequences", told["scheme"])
    assert len(samples) == len(plan)
    assert (control.scheme, control.state) == (Scheme.STEPPED.value, ScanState.COMPLETE)
    assert control.expected_s == pytest.approx(took_s, rel=0.05)
    lag = Lag.of_text(event_row("lag", told["lag"])["text"][0].decode())  # what a recording holds of it
    assert lag.refused in told["scheme"]
    with open_bench(bright(**changes)) as bench:
        choice = choose(plan, bench, checked_angles(plan, bench, aim_of(bench)), lag=lag)
        assert choice.scheme is Scheme.STEPPED
        assert lag.refused in choice.why
        rest = list(scan(plan, bench, taken=dict.fromkeys(range(500), 0), lag=lag))
    for sample, first in zip(rest, samples[500:], strict=True):
        assert np.array_equal(sample.histogram.counts, first.histogram.counts)


def test_whoever_asks_for_lines_by_name_has_a_lag_that_was_refused_measured_again(
    bright: Benches, small_plan: Plans
) -> None:
    lag = Lag.of_text(Lag(math.nan, math.inf, "too little light.").text())
    assert (lag.refused, lag.within_px) == ("too little light.", math.inf)
    with open_bench(bright()) as bench:
        *_, measured = swept(fast_plan(small_plan), bench, lag=lag)
    assert not measured.refused


def test_lines_are_swept_where_that_is_faster_and_the_plan_allows_it(bright: Benches, small_plan: Plans) -> None:
    long = {"wall": {"width_m": 0.5, "height_m": 1.0, "rows": 64, "cols": 64}, "dwell_ms": 0.1}
    with open_bench(bright(name="simulated")) as bench:
        for plan, scheme in [
            (fast_plan(small_plan, **long), Scheme.SWEPT),
            (fast_plan(small_plan), Scheme.CLOCKED),
            (fast_plan(small_plan, **long, continuous=None), Scheme.CLOCKED),
            (fast_plan(small_plan, dwell_ms=8), Scheme.CLOCKED),
        ]:
            angles = checked_angles(plan, bench, aim_of(bench))
            assert choose(plan, bench, angles).scheme is scheme
        plan = fast_plan(small_plan, **long)
        expected = forecast(Scheme.SWEPT, plan, bench, checked_angles(plan, bench, aim_of(bench)))
        started_s = bench.clock.now()
        assert len(list(scan(plan, bench, lag=KNOWN))) == len(plan)
        took_s = bench.clock.now() - started_s
        known = forecast(Scheme.SWEPT, plan, bench, checked_angles(plan, bench, aim_of(bench)), lag=KNOWN)
        assert known.total_s == pytest.approx(took_s, rel=0.05)
        assert known.total_s < expected.total_s


def test_in_little_light_the_lag_takes_longer_to_measure_and_the_forecast_says_by_how_much(
    bright: Benches, small_plan: Plans
) -> None:
    wall = {"width_m": 1.0, "height_m": 1.0, "rows": 4, "cols": 64}
    plan = fast_plan(small_plan, wall=wall, dwell_ms=0.122)
    with open_bench(bright(name="simulated", direct_cps=40e3)) as bench:
        expected = forecast(Scheme.SWEPT, plan, bench, checked_angles(plan, bench, aim_of(bench)))
        started_s = bench.clock.now()
        assert len(list(scan(plan, bench, scheme=Scheme.SWEPT))) == len(plan)
        took_s = bench.clock.now() - started_s
    low_s, high_s = expected.band_s
    assert low_s < expected.total_s * 1.05 < took_s < high_s


def test_photons_listed_one_by_one_are_swept_too(bright: Benches, small_plan: Plans) -> None:
    plan, settings = fast_plan(small_plan), bright()
    counter = settings.counter.model_copy(update={"mode": "t3"})
    with open_bench(settings.model_copy(update={"counter": counter})) as bench:
        assert bench.counter.list_mode
        samples, off_px, lag = swept(plan, bench)
    assert [sample.point for sample in samples] == list(plan)
    assert off_px <= lag.within_px


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", ["missed", "extra"])
@pytest.mark.parametrize("skip", [50, 3500])
def test_a_lost_step_is_noticed_on_the_way(bright: Benches, small_plan: Plans, skip: int, kind: str) -> None:
    """While the lag is measured, and later."""
    plan = fast_plan(small_plan)
    results = []
    for faults in ([], [Fault(name="A6", skip=skip, parameters={"kind": kind})]):
        with open_bench(bright(*faults)) as bench:
            samples, off_px, lag = swept(plan, bench)
            assert off_px <= lag.within_px
            results.append((lag, [sample.histogram.counts for sample in samples]))
    undisturbed, disturbed = results
    assert disturbed[0] == undisturbed[0]
    assert np.array_equal(disturbed[1], undisturbed[1])


def test_a_line_begun_in_the_middle_is_swept_whole(bright: Benches, small_plan: Plans) -> None:
    plan = fast_plan(small_plan)
    with open_bench(bright()) as bench:
        whole, _, lag = swept(plan, bench)
    taken = {number: 0 for number in range(len(plan)) if number < 100 or number % 7 == 0}
    with open_bench(bright()) as bench:
        rest, off_px, _ = swept(plan, bench, taken=taken, lag=lag)
    expected = [sample for sample in whole if sample.point.number not in taken]
    assert [s.point for s in rest] == [s.point for s in expected]
    assert np.array_equal([s.histogram.counts for s in rest], [s.histogram.counts for s in expected])
    assert off_px <= lag.within_px


def test_a_pause_while_the_lag_is_measured_loses_nothing(bright: Benches, small_plan: Plans) -> None:
    plan = fast_plan(small_plan)
    for goes_on in (True, False):
        control = ScanControl(lambda why, goes_on=goes_on: goes_on)
        control.interrupt("Ctrl-C")
        with open_bench(bright()) as bench:
            samples = list(scan(plan, bench, scheme=Scheme.SWEPT, control=control))
            assert bench.simulated is not None
            assert not bench.simulated.shutter_open
        assert len(samples) == (len(plan) if goes_on else 0)
        assert control.state is (ScanState.COMPLETE if goes_on else ScanState.ENDED)


def test_a_plan_that_does_not_allow_it_or_stops_at_counts_is_not_swept(
    bench_settings: Benches, small_plan: Plans
) -> None:
    with open_bench(bench_settings()) as bench, pytest.raises(ValueError, match="does not allow"):
        scan(small_plan(), bench, scheme=Scheme.SWEPT)
    stop = {"kind": "stop_at_counts", "counts": 20, "from_ns": 11.0, "to_ns": 15.0}
    with pytest.raises(PlanRefused, match="uneven pace"):
        fast_plan(small_plan, exposure=stop)


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ({"kind": "circle", "points": 360, "radius_m": 0.2}, "several directions"),
        ({"kind": "random", "points": 200, "seed": 1}, "lines have"),
    ],
)
def test_plans_without_long_parallel_lines_are_refused(
    bench_settings: Benches, small_plan: Plans, pattern: dict[str, Any], message: str
) -> None:
    plan = fast_plan(small_plan, pattern=pattern)
    with open_bench(bench_settings()) as bench, pytest.raises(LimitError, match=message):
        scan(plan, bench, scheme=Scheme.SWEPT)


def test_a_run_up_beyond_the_mirrors_reach_is_refused_before_anything_moves(
    bench_settings: Benches, small_plan: Plans
) -> None:
    wall = {"width_m": 3.3, "height_m": 1.0, "rows": 2, "cols": 64}
    plan = small_plan(wall=wall, dwell_ms=0.35, continuous={})
    with open_bench(bench_settings()) as bench:
        angles = checked_angles(plan, bench, aim_of(bench))
        with pytest.raises(LimitError, match="outside"):
            scan(plan, bench, scheme=Scheme.SWEPT)
        choice = choose(plan, bench, angles)
    assert choice.scheme is Scheme.STEPPED  # which is faster than clocked here
    assert "not in continuous lines" in choice.why
    assert "mirror x" in choice.why


def test_a_line_faster_than_the_mirror_is_refused(bench_settings: Benches, small_plan: Plans) -> None:
    plan = small_plan(4, 24, dwell_ms=0.1, continuous={})
    with open_bench(bench_settings()) as bench, pytest.raises(LimitError, match=r"cannot follow a line in 2\.\d+ ms"):
        scan(plan, bench, scheme=Scheme.SWEPT)


def test_a_recording_keeps_that_its_lines_were_continuous(small_plan: Plans, run_path: Any) -> None:
    plan = fast_plan(small_plan, continuous={"within_pixels": 0.125})
    RecordingWriter.create(run_path, plan, Header()).finish(1)  # type: ignore[arg-type]
    with Recording.open(run_path) as recording:
        assert recording.plan == plan
        assert recording.plan.within_px == 0.125


@pytest.mark.parametrize("list_mode", [False, True])
def test_every_line_begins_at_rest(bench_settings: Benches, small_plan: Plans, list_mode: bool) -> None:
    plan = fast_plan(small_plan, pattern="raster")
    with open_bench(bench_settings()) as bench:
        settle = bench.mirror.settle_s
        angles = checked_angles(plan, bench, aim_of(bench))
        lines = continuous_lines(plan, bench, angles)
        lines.lag_s = 1e-4
        made = partial(sweep, lines=lines)(list(plan), angles, settle, 1200, list_mode)
    assert len(made.index) == len(made.angles) == len(made.dwells_s) == len(made.numbers) <= 1200
    assert len(set(made.numbers)) == len(made.numbers)
    before, begun = made.angles[0], 0
    for place, stay in groupby(zip(made.angles, made.dwells_s, strict=True), key=lambda entry: entry[0]):
        if place.x_rad < before.x_rad:  # a fly-back
            assert sum(dwell_s for _, dwell_s in stay) >= settle(before, place)
            begun += 1
        before = place
    assert begun > 5
    if list_mode:
        assert len(set(made.dwells_s)) == 1


def test_a_line_is_commanded_by_its_lag_too_far_from_its_run_up_to_its_end(
    bench_settings: Benches, small_plan: Plans
) -> None:
    plan = fast_plan(small_plan, pattern="raster")
    with open_bench(bench_settings()) as bench:
        settle = bench.mirror.settle_s
        lines = continuous_lines(plan, bench, checked_angles(plan, bench, aim_of(bench)))
        lines.lag_s = 1.5 * 0.2e-3  # one point and a half
        end = int(lines.end[0])
        commands = lines.commands(0, end, settle)
        told, place = np.stack(axes_rad(commands), axis=1), lines.place[:end]
        run_up = len(told) - len(place)
        step_s = settle(MirrorAngles(*place[0]), MirrorAngles(*place[1]))
        assert run_up == int(np.ceil(2 * (step_s + 0.3e-3) / 0.2e-3))
        assert told[0] == pytest.approx(place[0] - (run_up - 1.5) * (place[1] - place[0]))
        assert told[run_up:-2] == pytest.approx((place[1:-1] + place[2:]) / 2)
        assert told[-1] == pytest.approx(place[-1] + 1.5 * (place[-1] - place[-2]))
        lines.check(settle, len(commands))
        with pytest.raises(LimitError, match=f"holds {len(commands) - 1} positions; a continuous line of {end} points"):
            lines.check(settle, len(commands) - 1)


def test_lines_end_where_steps_or_dwells_change() -> None:
    place = np.array([(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (2, 1), (1, 1)], dtype=float)
    dwells = np.ones(7)
    assert line_length(place, dwells) == 4
    assert line_length(place[3:], dwells[3:]) == 2
    assert line_length(place[4:], dwells[4:]) == 3
    assert line_length(place[:1], dwells[:1]) == 1
    assert line_length(place, np.array([1.0, 1.0, 2.0, 1.0, 1.0, 1.0, 1.0])) == 2
    assert line_length(place, np.array([1.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0])) == 1


@pytest.mark.parametrize("action", ["abort", "pause"])
def test_the_scans_alarms_stand_while_the_lag_is_measured_too(bright: Benches, small_plan: Plans, action: str) -> None:
    asked, kinds = list[str](), list[str]()
    control = ScanControl(lambda why: bool(asked.append(why)))
    chosen = bright()
    watch = Alarms(AlarmSettings(pile_up=1e-4, on_count_rate=Action(action)), chosen.laser.repetition_hz)
    with open_bench(chosen) as bench:
        bench.on_event = lambda kind, text: kinds.append(kind)
        with pytest.raises(AlarmRaised, match="pile-up"):
            list(scan(fast_plan(small_plan), bench, scheme=Scheme.SWEPT, control=control, alarms=watch))
        assert bench.simulated is not None
        assert not bench.simulated.shutter_open
    assert len(asked) == (action == "pause")
    assert "lag" not in kinds
    assert control.state is ScanState.STOPPED


@pytest.fixture
def fenced(bright: Benches) -> Callable[..., BenchSettings]:
    """A bench whose beam may go so far from the wall's centre."""

    def make(half_m: float, **options: Any) -> BenchSettings:
        settings = bright(**options)
        allowed = AllowedArea(left_m=-half_m, right_m=half_m, bottom_m=-half_m, top_m=half_m)
        return settings.model_copy(update={"geometry": settings.geometry.model_copy(update={"allowed": allowed})})

    return make


@pytest.mark.parametrize("lag", [KNOWN, None], ids=["known", "to be measured"])
def test_no_line_is_swept_whose_run_up_leaves_what_is_allowed(
    fenced: Callable[..., BenchSettings], small_plan: Plans, lag: Lag | None
) -> None:
    """It is lit as the points are; here they fill the allowed area."""
    plan = fast_plan(small_plan)
    with open_bench(fenced(0.25)) as bench:
        with pytest.raises(LimitError, match=r"run-up .*outside the allowed area.*`continuous` out"):
            scan(plan, bench, scheme=Scheme.SWEPT, lag=lag)
        choice = choose(plan, bench, checked_angles(plan, bench, aim_of(bench)), lag=lag)
        assert choice.scheme is not Scheme.SWEPT
        assert "run-up" in choice.why


def test_a_run_up_is_held_against_where_the_beam_lands_not_against_equal_steps_on_the_wall(
    fenced: Callable[..., BenchSettings], small_plan: Plans
) -> None:
    """Equal steps of the mirror are ever longer ones on the wall: some millimetres to centimetres beyond the points."""
    plan = fast_plan(small_plan)

    def farthest_m(half_m: float) -> float:
        with open_bench(fenced(half_m)) as bench:
            aim, angles = aim_of(bench), checked_angles(plan, bench, aim_of(bench))
            lines = continuous_lines(plan, bench, angles)
            ways = [
                lines.commands(*each, bench.mirror.settle_s) for each in {*zip(lines.first, lines.end, strict=True)}
            ]
            return max(abs(at_m) for way in ways for each in way for at_m in aim.wall_point(each))

    landed_m = farthest_m(10.0)
    assert farthest_m(landed_m + 1e-6) == pytest.approx(landed_m)
    with pytest.raises(LimitError, match="run-up"):
        farthest_m(landed_m - 1e-4)


def test_lines_with_room_for_their_run_ups_are_swept(fenced: Callable[..., BenchSettings], small_plan: Plans) -> None:
    plan = fast_plan(small_plan)
    with open_bench(fenced(0.5)) as bench:
        assert len(list(scan(plan, bench, scheme=Scheme.SWEPT, lag=KNOWN))) == len(plan)


@pytest.mark.parametrize("list_mode", [False, True])
def test_a_run_up_begins_once_the_mirror_has_come_back_and_is_at_rest(list_mode: bool) -> None:
    """The end of the line before was no rest: the jump back and a step have settled by then."""
    settle, dwell_s = SettleModel().settle_s, 0.2e-3
    line = [MirrorAngles(k * 1e-3, 0.0) for k in range(40)]
    made = Stepping([], [], [], [], 0.0, 0)
    for _ in range(2):
        made = append_line(made, line, list(range(40)), dwell_s, settle, list_mode)
    waits = range(40, len(made.index) - 40)
    assert {made.index[entry] for entry in waits} == {-1}
    assert {made.angles[entry] for entry in waits} == {line[0]}
    waited_s = sum(made.dwells_s[entry] for entry in waits)
    assert waited_s >= settle(line[-1], line[0]) + settle(line[0], line[1]) - 1e-9


def farthest_m(lines: Lines, bench: Bench, lag_s: float, dwell_s: float | None = None) -> float:
    """From the wall's centre, of all that the plan's lines are told, at another pace than the plan's."""
    lines.lag_s = lag_s
    ways = [np.arange(*each) for each in {*zip(lines.first.tolist(), lines.end.tolist(), strict=True)}]
    told = [lines.along(way, bench.mirror.settle_s, dwell_s) for each in ways for way in (each, each[::-1])]
    return max(abs(at_m) for way in told for each in way for at_m in aim_of(bench).wall_point(each))


LAGS_MORE = {"bandwidth_hz": 1200.0, "delay_us": 60.0}
"""A head that trails by 0.24 ms, where its table lets one guess 0.2 ms."""


@pytest.mark.parametrize("found_by", ["the measurement", "the lag that it ends with"])
def test_lines_that_do_not_fit_by_the_lag_that_is_measured_are_taken_point_by_point(
    bright: Benches, fenced: Callable[..., BenchSettings], small_plan: Plans, monkeypatch: pytest.MonkeyPatch,
    found_by: str,
) -> None:  # fmt: skip
    """Where nobody asked for lines by name: no such scan ends by an error, and no light falls beside what is
    allowed."""
    monkeypatch.setattr(schemes, "USUAL", 0)  # else so small a scan is not worth the measurement
    plan = fast_plan(small_plan, wall={**WALL, "rows": 6})
    with open_bench(bright(servo=LAGS_MORE)) as bench:
        lines = continuous_lines(plan, bench, checked_angles(plan, bench, aim_of(bench)))
        pace_s = lag_trial.trial_dwell_s(lines)
        fits_m, beyond_m = (farthest_m(lines, bench, lag_s, pace_s) for lag_s in (0.2e-3, 0.235e-3))
    assert fits_m < beyond_m
    if found_by == "the lag that it ends with":
        monkeypatch.setattr(lag_trial, "measure", lambda *_: Lag(1e-3, 0.1))
    half_m = (fits_m + beyond_m) / 2
    with open_bench(fenced(half_m, servo=LAGS_MORE)) as bench:
        assert bench.simulated is not None
        aim, table = aim_of(bench), bench.simulated
        assert choose(plan, bench, checked_angles(plan, bench, aim)).scheme is Scheme.SWEPT
        told, lit_m, seen = list[str](), list[float](), dict[int | None, tuple[float, float]]()

        def gate(gate: Gate, beam: MirrorAngles) -> None:
            seen[gate.number] = aim.wall_point(beam)
            lit_m.extend(abs(each) for each in seen[gate.number] if table.shutter_open)

        bench.on_event = lambda kind, text: told.append(text) if kind == "scheme" else None
        table.on_gate = gate
        control = ScanControl()
        samples = list(scan(plan, bench, control=control))
        table.on_gate = None
        assert not table.shutter_open
    assert sorted(sample.point.number for sample in samples) == list(range(len(plan)))
    assert max(lit_m) <= half_m
    assert max(np.hypot(seen[p.number][0] - p.x_m, seen[p.number][1] - p.y_m) for p in plan) < 2e-3
    assert told[0].startswith(Scheme.SWEPT.value)
    assert told[1].startswith(Scheme.STEPPED.value)
    assert "not in continuous lines: the run-up" in told[1]
    assert (control.scheme, control.state) == (Scheme.STEPPED.value, ScanState.COMPLETE)


def test_run_ups_are_held_against_where_measured_mirrors_put_them(
    fenced: Callable[..., BenchSettings], small_plan: Plans
) -> None:
    """A head whose spots say that it turns more per volt than the bench file has it."""
    plan = fast_plan(small_plan, wall={**WALL, "rows": 6})
    with open_bench(fenced(10.0)) as bench:
        drawn = bench.settings.geometry
        aim = ScannerGeometry(drawn.wall_distance_m, drawn.mirror_separation_m, x_gain=1.25, y_gain=1.25)
        angles = checked_angles(plan, bench, aim)
        ways = continuous_lines(plan, bench, angles, aim)
        ways.lag_s = KNOWN.lag_s
        told = [each for at in np.unique(ways.first) for each in ways.commands(at, ways.end[at], bench.mirror.settle_s)]
        x_m, y_m = aim.wall_points(*axes_rad(told))
    reached_m = float(max(np.abs(x_m).max(), np.abs(y_m).max()))
    for half_m, fits in ((reached_m + 1e-6, True), (reached_m - 1e-6, False)):
        with open_bench(fenced(half_m)) as bench:
            if fits:
                assert scan(plan, bench, aim=aim, scheme=Scheme.SWEPT, lag=KNOWN)
                continue
            with pytest.raises(LimitError, match="run-up"):
                scan(plan, bench, aim=aim, scheme=Scheme.SWEPT, lag=KNOWN)
            assert "run-up" in choose(plan, bench, angles, lag=KNOWN, aim=aim).why
