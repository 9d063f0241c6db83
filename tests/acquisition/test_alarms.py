"""Alarms notice what no device reports, do what the scan file says, and keep nothing that was taken under them."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.scanning.alarms import AlarmRaised, Alarms, AlarmSettings
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.acquisition.scanning.engine import scan
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]
REPETITION_HZ = 10e6


def sample_at(total_count: int, sync_hz: float = REPETITION_HZ, live_s: float = 0.01) -> Sample:
    counts = np.zeros(64, dtype=np.uint32)
    sync_count = round(sync_hz * live_s)
    histogram = Histogram(counts, 16e-12, 0.0, live_s, sync_count, total_count, HistogramFlag.NONE, 0.0)
    return Sample(ScanPoint(0, 0, 0, 0.0, 0.0, live_s), histogram, 0.0)


def alarms(free_mb: Iterator[float] | None = None, **limits: Any) -> Alarms:
    settings_ = AlarmSettings.model_validate(limits)
    if free_mb is None:
        return Alarms(settings_, REPETITION_HZ)
    return Alarms(settings_, REPETITION_HZ, Path(), lambda folder: int(next(free_mb) * 1e6))


def light(bench: Bench) -> bool:
    assert bench.simulated is not None
    return bench.simulated.shutter_open


def test_a_raised_alarm_clears_well_on_the_good_side_of_its_limit() -> None:
    watch = alarms()
    seen = [watch.judge(sample_at(round(rate * 0.01))) is not None for rate in (4e5, 6e5, 4e5, 3e5, 2e5, 4e5, 5.1e5)]
    assert seen == [False, True, True, True, False, False, True]


@settings(max_examples=200, deadline=None)
@given(rates=st.lists(st.floats(1e3, 1e6), min_size=1, max_size=50))
def test_an_alarm_never_stands_below_half_its_limit_nor_rests_above_it(rates: list[float]) -> None:
    watch = alarms()
    for rate in rates:
        count = round(rate * 0.01)
        stands = watch.judge(sample_at(count)) is not None
        assert stands or count <= 5000
        assert not stands or count > 2500


@pytest.mark.parametrize(
    ("sync_hz", "stands"), [(10e6, False), (9.6e6, False), (9.4e6, True), (0.0, True), (11e6, True)]
)
def test_the_laser_must_pulse_as_the_bench_file_says(sync_hz: float, stands: bool) -> None:
    assert (alarms().judge(sample_at(100, sync_hz)) is not None) == stands


def test_short_dwells_do_not_look_like_a_wrong_pulse_rate() -> None:
    assert alarms().judge(sample_at(1, live_s=1.3e-6)) is None


def test_no_photons_where_there_were_some_is_noticed_only_when_it_cannot_be_chance() -> None:
    watch = alarms()
    assert all(watch.judge(sample_at(3)) is None for _ in range(50))
    blanks = [watch.judge(sample_at(0)) for _ in range(10)]
    assert [trouble is not None for trouble in blanks] == [False] * 8 + [True] * 2
    assert watch.judge(sample_at(3)) is None
    dark = alarms()
    assert all(dark.judge(sample_at(0)) is None for _ in range(1000))


def test_an_aborting_alarm_ends_the_scan_with_the_light_off(bench_settings: Benches, small_plan: Plans) -> None:
    control, events = ScanControl(), []
    with open_bench(bench_settings()) as bench:
        bench.on_event = lambda kind, text: events.append(kind)
        with pytest.raises(AlarmRaised, match=r"pile-up.*--resume"):
            list(scan(small_plan(), bench, control=control, alarms=alarms(pile_up=1e-4)))
        assert not light(bench)
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


def test_too_many_dark_counts_stop_a_scan_before_the_light_is_on(bench_settings: Benches, small_plan: Plans) -> None:
    with open_bench(bench_settings()) as bench:
        events: list[str] = []
        bench.on_event = lambda kind, text: events.append(f"{kind} {text}")
        with pytest.raises(AlarmRaised, match="dark counts"):
            list(scan(small_plan(), bench, alarms=alarms(max_dark_hz=1.0)))
    assert "shutter opened" not in events


def test_the_state_machine_knows_its_moves() -> None:
    control = ScanControl(lambda why: why == "go")
    with pytest.raises(RuntimeError, match="ready cannot become paused"):
        control.enter(ScanState.PAUSED)
    control.enter(ScanState.RUNNING)
    control.interrupt("go")
    assert control.pause()
    assert (control.state, control.wanted) == (ScanState.RUNNING, "")
    control.interrupt("stop")
    assert not control.pause()
    assert control.state is ScanState.ENDED
    with pytest.raises(RuntimeError, match="ended cannot become running"):
        control.enter(ScanState.RUNNING)
