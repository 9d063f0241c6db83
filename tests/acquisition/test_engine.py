"""The engine takes every point once, in order, in time, and leaves the light off whatever happens."""

from collections.abc import Callable

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.alarms import Alarms, AlarmSettings
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.acquisition.scanning.engine import scan
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.errors import BenchClosed, DeviceError, DeviceLost, LimitError, Preempted, SafetyTrip
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.tcspc.counter import CounterStatus

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]


def light(bench: Bench) -> bool:
    assert bench.simulated is not None
    return bench.simulated.shutter_open


def histograms(samples: list[Sample]) -> np.ndarray:
    return np.array([sample.histogram.counts for sample in samples])


def test_every_point_is_taken_once_in_the_plans_order(bench_settings: Benches, small_plan: Plans) -> None:
    plan, control = small_plan(), ScanControl()
    with open_bench(bench_settings()) as bench:
        samples = list(scan(plan, bench, control=control))
        assert not light(bench)
    assert [sample.point for sample in samples] == list(plan)
    assert all(sample.histogram.live_time_s == pytest.approx(0.008) for sample in samples)
    assert histograms(samples).sum() > 0
    assert control.state is ScanState.COMPLETE
    taken_s = np.array([sample.taken_s for sample in samples])
    assert np.diff(taken_s).min() >= 0.008


def test_one_plan_one_bench_one_result(bench_settings: Benches, small_plan: Plans) -> None:
    results = []
    for _ in range(2):
        with open_bench(bench_settings()) as bench:
            results.append(histograms(list(scan(small_plan(), bench))))
    assert (results[0] == results[1]).all()


def test_the_light_is_on_while_points_are_taken_and_only_then(bench_settings: Benches, small_plan: Plans) -> None:
    with open_bench(bench_settings()) as bench:
        samples = scan(small_plan(), bench)
        assert not light(bench)
        next(samples)
        assert light(bench)
        samples.close()
        assert not light(bench)


def test_a_wall_beyond_the_mirrors_reach_is_refused_before_anything_moves(
    bench_settings: Benches, small_plan: Plans
) -> None:
    sent: list[tuple[str, str, bytes]] = []
    wall = {"width_m": 9.0, "height_m": 1.0, "rows": 4, "cols": 4}
    with open_bench(bench_settings(), wire_log=lambda *line: sent.append(line)) as bench:
        before = len(sent)
        with pytest.raises(LimitError, match=r"wall point x = .* outside .*Shrink the wall"):
            scan(small_plan(wall=wall), bench)
        assert len(sent) == before


def test_a_dwell_or_axis_that_the_counter_cannot_set_is_refused(bench_settings: Benches, small_plan: Plans) -> None:
    with open_bench(bench_settings()) as bench:
        with pytest.raises(LimitError, match="bin width"):
            scan(small_plan(histogram={"bins": 64, "bin_width_ps": 100.0}), bench)
        assert bench.clock.now() < 10


def test_a_pause_discards_the_point_under_way_and_going_on_takes_it_again(
    bench_settings: Benches, small_plan: Plans
) -> None:
    plan, asked = small_plan(), []
    with open_bench(bench_settings()) as bench:
        undisturbed = histograms(list(scan(plan, bench)))
        events: list[tuple[str, str]] = []
        bench.on_event = lambda kind, text: events.append((kind, text))

        def ask(why: str) -> bool:
            asked.append((why, light(bench)))
            return True

        control = ScanControl(ask)
        samples = []
        for sample in scan(plan, bench, control=control):
            samples.append(sample)
            if len(samples) in (5, 20):
                bench.shutter.hold("signal")  # as a signal's handler does: until somebody goes on
                control.interrupt("Ctrl-C")
        assert asked == [("Ctrl-C", False), ("Ctrl-C", False)]
    assert [sample.point.number for sample in samples] == list(range(36))
    assert (histograms(samples) == undisturbed).all()
    assert ("scan", "paused by Ctrl-C") in events
    assert control.state is ScanState.COMPLETE


@pytest.mark.parametrize("scheme", [Scheme.STEPPED, Scheme.CLOCKED])
def test_a_person_may_pause_at_one_point_as_often_as_they_like(
    bench_settings: Benches, small_plan: Plans, scheme: Scheme
) -> None:
    """That no point comes of it is no fault of mirror or counter."""
    asked: list[str] = []
    control = ScanControl(lambda why: not asked.append(why))  # type: ignore[func-returns-value]
    with open_bench(bench_settings()) as bench:

        def pause(kind: str, text: str) -> None:
            if (kind, text) == ("shutter", "opened") and len(asked) < 6:
                control.interrupt()

        bench.on_event = pause
        assert len(list(scan(small_plan(), bench, control=control, scheme=scheme))) == 36
    assert len(asked) == 6


@pytest.mark.parametrize("scheme", [Scheme.STEPPED, Scheme.CLOCKED])
def test_the_light_is_off_before_gate_and_mirror_are_stopped(
    bench_settings: Benches, small_plan: Plans, scheme: Scheme, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a pause and at the end: either may take seconds to answer."""
    control, lit = ScanControl(lambda why: True), list[bool]()
    with open_bench(bench_settings()) as bench:
        for device, name in ((bench.counter, "abort"), (bench.mirror, "stop")):
            told = getattr(device, name)
            monkeypatch.setattr(device, name, lambda told=told: lit.append(light(bench)) or told())
        for sample in scan(small_plan(), bench, control=control, scheme=scheme):
            if sample.point.number == 10:
                control.interrupt()
                lit.clear()
    if scheme is Scheme.CLOCKED:
        lit.remove(True)  # a sequence that has ended leaves the mirror at rest while its last samples are handed on
    assert len(lit) >= 4
    assert not any(lit)


@pytest.mark.parametrize("step", ["rates", "configure"])
def test_a_step_that_a_signal_broke_into_is_taken_again(
    bench_settings: Benches, small_plan: Plans, step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before the light, where it may be taken twice: its answer was lost, and with it whether it was done."""
    plan, cut = small_plan(), [True, True]
    with open_bench(bench_settings()) as bench:
        told = getattr(bench.counter, step)

        def broken_into(*given: object) -> object:
            if cut:
                cut.pop()
                raise Preempted(bench.counter.identity.model, "the shutter was closed meanwhile.")
            return told(*given)

        monkeypatch.setattr(bench.counter, step, broken_into)
        alarms = Alarms(AlarmSettings(max_dark_hz=1e4), bench.settings.laser.repetition_hz)
        assert len(list(scan(plan, bench, alarms=alarms))) == 36
    assert not cut


@pytest.mark.parametrize("number", [0, 17, 35])
def test_a_point_whose_light_a_person_cut_off_at_its_end_is_taken_again(
    bench_settings: Benches, small_plan: Plans, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the counter is waited for: its histogram is there, and half dark."""
    plan, control, waits = small_plan(), ScanControl(lambda why: True), list[int]()
    with open_bench(bench_settings()) as bench:
        undisturbed = histograms(list(scan(plan, bench, scheme=Scheme.STEPPED)))
        wait_points = bench.counter.wait_points

        def interrupted(points: int, timeout_s: float) -> CounterStatus:
            waits.append(points)
            if len(waits) == number + 1:
                bench.shutter.close("signal")
                control.interrupt("Ctrl-C")
            return wait_points(points, timeout_s=timeout_s)

        monkeypatch.setattr(bench.counter, "wait_points", interrupted)
        samples = list(scan(plan, bench, control=control, scheme=Scheme.STEPPED))
    assert len(waits) == 37
    assert [sample.point.number for sample in samples] == list(range(36))
    assert (histograms(samples) == undisturbed).all()


def test_a_pause_within_a_long_dwell_does_not_wait_for_its_end(bench_settings: Benches, small_plan: Plans) -> None:
    control = ScanControl(lambda why: False)
    with open_bench(bench_settings()) as bench:
        samples = scan(small_plan(dwell_ms=8000), bench, control=control)
        next(samples)
        assert bench.simulated is not None
        started_s = bench.clock.now()
        control.interrupt()
        assert list(samples) == []
        assert bench.clock.now() - started_s < 1.0
    assert control.state is ScanState.ENDED


def test_decide_ends_a_scan_early(bench_settings: Benches, small_plan: Plans) -> None:
    control, left = ScanControl(), iter([False, False, True])
    with open_bench(bench_settings()) as bench:
        assert len(list(scan(small_plan(), bench, control=control, decide=lambda: next(left)))) == 3
        assert not light(bench)
    assert control.state is ScanState.ENDED


def test_decide_ends_a_first_pass_then_the_scan(bench_settings: Benches, small_plan: Plans) -> None:
    plan = small_plan(exposure={"kind": "two_pass", "counts": 10**6, "again_ms": 4})
    for answers, taken in (([False, False, True, False, True], [0, 1, 2, 36, 37]), ([True, False], [0, 36])):
        control, left = ScanControl(), iter(answers)
        with open_bench(bench_settings()) as bench:
            samples = list(scan(plan, bench, control=control, decide=lambda left=left: next(left)))
            assert not light(bench)
        assert [sample.point.number for sample in samples] == taken
        assert control.state is ScanState.ENDED


@pytest.mark.parametrize(
    ("before", "decided", "answers", "taken"),
    [
        (38, [38], [], []),
        (38, [], [True], []),
        (10, [10], [True], [36]),
        (10, [], [True, True], [36]),
        (0, [], [*[False] * 37, True], list(range(38))),
    ],
)
def test_a_yes_ends_the_pass_that_it_is_of_whenever_it_came(
    bench_settings: Benches, small_plan: Plans, before: int, decided: list[int], answers: list[bool], taken: list[int]
) -> None:
    """Of 36 points in each of two passes `before` were taken earlier; nobody is asked twice about the same samples."""
    plan = small_plan(exposure={"kind": "two_pass", "counts": 10**6, "again_ms": 4})
    control, left = ScanControl(), iter(answers)
    held = dict.fromkeys(range(before), 0)
    with open_bench(bench_settings()) as bench:
        samples = list(scan(plan, bench, control=control, taken=held, decided=decided, decide=lambda: next(left)))
    assert [sample.point.number for sample in samples] == taken
    assert control.state is ScanState.ENDED
    assert not list(left)


def test_only_what_is_missing_is_taken(bench_settings: Benches, small_plan: Plans) -> None:
    plan = small_plan()
    with open_bench(bench_settings()) as bench:
        everything = list(scan(plan, bench))
        taken = {number: 0 for number in range(36) if number % 5}
        rest = list(scan(plan, bench, taken=taken, elapsed_s=100.0))
    assert [sample.point.number for sample in rest] == list(range(0, 36, 5))
    assert (histograms(rest) == histograms(everything)[::5]).all()
    assert rest[0].taken_s > 100.0


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        (Fault(name="U11", after_s=0.2), DeviceLost),
        (Fault(name="G8", after_s=0.2), DeviceLost),
        (Fault(name="U14", after_s=0.2), SafetyTrip),
    ],
)
def test_after_an_error_the_light_is_off_and_what_was_taken_is_there(
    bench_settings: Benches, small_plan: Plans, fault: Fault, error: type[DeviceError]
) -> None:
    control, samples = ScanControl(), []
    with pytest.raises(error), open_bench(bench_settings(fault)) as bench:  # noqa: PT012 - the scan is what raises
        for sample in scan(small_plan(), bench, control=control):
            samples.append(sample)
    assert 0 < len(samples) < 36
    assert not light(bench)  # U11 takes the cable that carries the shutter's commands away: the watchdog has closed it
    assert control.state in (ScanState.FAILED, ScanState.STOPPED)


def test_every_plan_gets_a_hundredth_of_a_second_of_overhead_at_most(
    bench_settings: Benches, small_plan: Plans
) -> None:
    """In the bench's own time, on its real latencies: 8 ms dwell, 0.4 ms settling, the rest is links."""
    plan = small_plan(12, 12)
    with open_bench(bench_settings(name="simulated")) as bench:
        start_s = bench.clock.now()
        list(scan(plan, bench))
        per_point_s = (bench.clock.now() - start_s) / len(plan)
    assert 0.0084 < per_point_s < 0.0119


def test_a_scan_whose_bench_is_closed_refuses_to_go_on(
    bench_settings: Callable[..., BenchSettings], small_plan: Plans
) -> None:
    with open_bench(bench_settings()) as bench:
        samples = scan(small_plan(), bench)
        begun = scan(small_plan(), bench)
        next(begun)
    lines: list[str] = []
    assert bench.simulated is not None
    bench.simulated.witness = lambda when_s, what: lines.append(what)
    for source in (samples, begun):
        with pytest.raises(BenchClosed):
            next(source)
    assert not bench.simulated.shutter_open
    assert lines == []
