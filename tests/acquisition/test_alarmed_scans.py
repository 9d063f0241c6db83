"""Scans under alarms: what one does to the light, to the points taken under it, and to what the event log says."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.scanning.alarms import AlarmRaised, Alarms, AlarmSettings
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.acquisition.scanning.engine import scan
from nlos.drivers.bench import Bench, BenchSettings, open_bench

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]
REPETITION_HZ = 10e6


def alarms(free_mb: Iterator[float] | None = None, **limits: Any) -> Alarms:
    settings_ = AlarmSettings.model_validate(limits)
    if free_mb is None:
        return Alarms(settings_, REPETITION_HZ)
    return Alarms(settings_, REPETITION_HZ, Path(), lambda folder: int(next(free_mb) * 1e6))


def light(bench: Bench) -> bool:
    assert bench.simulated is not None
    return bench.simulated.shutter_open


def test_an_aborting_alarm_ends_the_scan_with_the_light_off(bench_settings: Benches, small_plan: Plans) -> None:
    control, events = ScanControl(), []
    with open_bench(bench_settings()) as bench:
        bench.on_event = lambda kind, text: events.append(kind)
        with pytest.raises(AlarmRaised, match=r"pile-up.*Fix it"):
            list(scan(small_plan(), bench, control=control, alarms=alarms(pile_up=1e-4)))
        assert not light(bench)
        bench.shutter.check_trip()  # it is no trip, which somebody has to clear by name
    assert control.state is ScanState.STOPPED
    assert "alarm" in events


def test_a_pausing_alarm_lets_a_person_mend_it_and_takes_the_points_again(
    bench_settings: Benches, small_plan: Plans
) -> None:
    plan, asked = small_plan(12, 12), []
    watch = alarms(iter([500.0, 500.0, 20.0, 120.0, *[900.0] * 99]), on_disk="pause")
    with open_bench(bench_settings()) as bench:
        undisturbed = [s.histogram.counts for s in scan(plan, bench)]
        control = ScanControl(lambda why: not asked.append((why, light(bench))))  # type: ignore[func-returns-value]
        samples = list(scan(plan, bench, control=control, alarms=watch))
    assert [s.point.number for s in samples] == list(range(144))
    assert np.array_equal([s.histogram.counts for s in samples], undisturbed)
    assert [(why.split(":")[0], on) for why, on in asked] == [("alarm", False), ("alarm", False)]
    assert "20 MB are left" in asked[0][0]
    assert "120 MB are left" in asked[1][0]
    assert control.state is ScanState.COMPLETE


def test_a_person_who_ends_a_scan_after_an_alarm_was_mended_ends_it(bench_settings: Benches, small_plan: Plans) -> None:
    """The alarm is over and done with: it is not what ended the scan."""
    answers, events = iter([True, False]), []
    control = ScanControl(lambda why: next(answers))
    watch = alarms(iter([20.0, *[900.0] * 99]), on_disk="pause")
    with open_bench(bench_settings()) as bench:
        bench.on_event = lambda kind, text: events.append((kind, text))
        for _ in scan(small_plan(), bench, control=control, alarms=watch):
            control.interrupt("Ctrl-C")
    assert control.state is ScanState.ENDED
    assert ("scan", "ended while paused by Ctrl-C") in events


def test_after_a_pause_alarms_are_looked_at_in_the_dark_again(bench_settings: Benches, small_plan: Plans) -> None:
    """Who went to the table may have filled the disk, or left the lights on."""
    events: list[tuple[str, str]] = []
    control = ScanControl(lambda why: True)
    watch = alarms(iter([900.0, 900.0, 20.0, *[900.0] * 99]), on_disk="pause")
    with open_bench(bench_settings()) as bench:
        bench.on_event = lambda kind, text: events.append((kind, text))
        taken = 0
        for _ in scan(small_plan(), bench, control=control, alarms=watch):
            taken += 1
            if taken == 5:
                control.interrupt("Ctrl-C")
    assert taken == 36
    after = [text for kind, text in events[events.index(("scan", "resumed")) :] if kind in ("scan", "shutter")]
    assert after[1].startswith("paused: alarm: 20 MB are left")
    assert after[2:4] == ["resumed", "opened"]


def test_a_pausing_alarm_off_a_terminal_ends_the_scan(bench_settings: Benches, small_plan: Plans) -> None:
    control = ScanControl()
    with open_bench(bench_settings()) as bench, pytest.raises(AlarmRaised, match="MB are left"):
        list(scan(small_plan(), bench, control=control, alarms=alarms(iter([5.0] * 9), on_disk="pause")))
    assert control.state is ScanState.STOPPED


def test_skipped_points_come_last_and_are_given_up_in_the_end(bench_settings: Benches, small_plan: Plans) -> None:
    plan = small_plan()
    with open_bench(bench_settings()) as bench:
        rates = [s.histogram.total_count / s.histogram.live_time_s for s in scan(plan, bench)]
        limit = float(np.max(rates[:20])) * 1.001 / REPETITION_HZ
        bad = [number for number, rate in enumerate(rates) if rate > limit * REPETITION_HZ]
        assert bad
        taken: list[int] = []
        with pytest.raises(AlarmRaised, match="pile-up"):
            taken.extend(s.point.number for s in scan(plan, bench, alarms=alarms(pile_up=limit, on_count_rate="skip")))
    assert set(taken).isdisjoint(bad)
    assert taken[:20] == list(range(20))


@pytest.mark.parametrize("scheme", [Scheme.STEPPED, Scheme.CLOCKED])
@pytest.mark.parametrize("dwell_ms", [60, 300])
def test_a_point_that_is_too_bright_is_skipped_however_long_its_dwell(
    bench_settings: Benches, small_plan: Plans, scheme: Scheme, dwell_ms: float
) -> None:
    """In the middle of a long one the rate meter is asked: what it says is said of the point under way."""
    plan, events = small_plan(3, 3, dwell_ms=dwell_ms), []
    with open_bench(bench_settings()) as bench:
        rates = [s.histogram.total_count / s.histogram.live_time_s for s in scan(plan, bench)]
        bench.on_event = lambda kind, text: events.append((kind, text))
        bright, limit_hz = int(np.argmax(rates[:-1])), max(rates[:-1]) * 0.9
        usual = [number for number, rate in enumerate(rates) if rate < limit_hz / 2]
        assert usual
        taken: list[int] = []
        watch = alarms(pile_up=limit_hz / REPETITION_HZ, on_count_rate="skip")
        with pytest.raises(AlarmRaised, match="pile-up"):
            taken.extend(sample.point.number for sample in scan(plan, bench, scheme=scheme, alarms=watch))
    assert bright not in taken
    assert set(usual) <= set(taken)
    raised = [place for place, (kind, _) in enumerate(events) if kind == "alarm"]
    assert all(events[place - 1] == ("shutter", "closed: alarm: count rate") for place in raised)  # before all else
    said = [events[place][1] for place in raised]
    assert all(text.endswith("The point is left for the end of the scan.") for text in said[:-1])
    assert said[-1].endswith("The light is off and the scan ends.")


@pytest.mark.parametrize("action", ["abort", "pause"])
def test_too_many_dark_counts_stop_a_scan_before_the_light_is_on(
    bench_settings: Benches, small_plan: Plans, action: str
) -> None:
    with open_bench(bench_settings()) as bench:
        events: list[str] = []
        bench.on_event = lambda kind, text: events.append(f"{kind} {text}")
        with pytest.raises(AlarmRaised, match="dark counts"):
            list(scan(small_plan(), bench, alarms=alarms(max_dark_hz=1.0, on_dark_rate=action)))
    assert "shutter opened" not in events
