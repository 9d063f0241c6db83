"""Alarms notice what no device reports, do what the scan file says, and keep nothing that was taken under them."""

import errno
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.scanning.alarms import BLOCK, AlarmRaised, Alarms, AlarmSettings, Expected
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.acquisition.scanning.engine import scan
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.tcspc.counter import CountRates, Histogram, HistogramFlag

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


def test_a_point_without_any_live_time_is_not_judged() -> None:
    """As one that is kept with its flags after it was lost three times."""
    nothing = replace(sample_at(0), histogram=replace(sample_at(0).histogram, live_time_s=0.0, sync_count=0))
    assert alarms().judge(nothing) is None
    assert alarms().judge_trial(nothing) is None


@pytest.mark.parametrize(("pulses", "stands"), [(7, True), (8, True), (9, False), (11, False), (12, True)])
def test_one_pulse_more_or_less_is_how_the_gate_fell(pulses: int, stands: bool) -> None:
    """Ten are due in a microsecond."""
    assert (alarms().judge(sample_at(0, pulses * 1e6, 1e-6)) is not None) == stands


def test_a_rate_is_one_of_a_millisecond_and_begins_anew_after_it() -> None:
    """1e6 counts/s, twice what is allowed, for 0.9 ms; then nothing more."""
    watch = alarms()
    assert all(watch.judge(sample_at(90, live_s=9e-5)) is None for _ in range(10))
    trouble = watch.judge(sample_at(150, live_s=1.5e-4))
    assert trouble is not None
    assert trouble.name == "count rate"
    assert watch.judge(sample_at(100, live_s=1e-3)) is None


@pytest.mark.parametrize(("detector_hz", "stands"), [(1299.0, False), (1301.0, True)])
@pytest.mark.parametrize("shutter_on", ["counter", "nothing"])
def test_counts_in_the_dark_are_usual_up_to_three_times_what_they_were_and_a_thousand(
    detector_hz: float, stands: bool, shutter_on: str
) -> None:
    counter = SimpleNamespace(rates=lambda: CountRates(REPETITION_HZ, detector_hz))
    bench = cast(Bench, SimpleNamespace(counter=counter, settings=SimpleNamespace(shutter_on=shutter_on)))
    watch = Alarms(AlarmSettings(), REPETITION_HZ, expected=Expected(usual_dark_hz=100.0))
    assert (watch.before(bench) is not None) == (stands and shutter_on == "counter")


@pytest.mark.parametrize(
    ("sync_hz", "detector_hz", "name"), [(1e7, 4.9e5, None), (1e7, 5.1e5, "count rate"), (9e6, 1e3, "sync")]
)
def test_a_rate_meter_is_held_against_the_same_limits(sync_hz: float, detector_hz: float, name: str | None) -> None:
    trouble = alarms().judge_rates(CountRates(sync_hz, detector_hz))
    assert (trouble and trouble.name) == name


def test_the_disk_is_looked_at_with_every_block() -> None:
    watch = alarms(iter([900.0, 90.0]), on_disk="pause")
    troubles = [watch.judge(sample_at(100)) for _ in range(BLOCK + 1)]
    assert [trouble is not None for trouble in troubles] == [False] * BLOCK + [True]
    assert alarms(iter([99.9])).judge(sample_at(100)) is not None
    assert alarms(iter([100.0])).judge(sample_at(100)) is None


@pytest.mark.parametrize("number", [errno.EIO, errno.ETIMEDOUT, errno.ESTALE, errno.ENOENT, errno.EACCES])
def test_a_disk_that_does_not_say_how_much_room_it_has_ends_no_scan(number: int) -> None:
    def free(folder: Path) -> int:
        raise OSError(number, os.strerror(number), str(folder))

    watch = Alarms(AlarmSettings(), REPETITION_HZ, Path("run"), free)
    assert watch.judge(sample_at(100)) is None


def test_wrong_direct_light_is_said_once() -> None:
    watch = Alarms(AlarmSettings(), REPETITION_HZ, expected=Expected(direct=lambda sample: "it is late"))
    first = watch.judge(sample_at(100))
    assert first is not None
    assert (first.name, first.text) == ("direct", "it is late")
    assert watch.judge(sample_at(100)) is None


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
    said = [text for kind, text in events if kind == "alarm"]
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
