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
from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.scanning.alarms import BLOCK, Action, Alarms, AlarmSettings, Expected
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.drivers.bench import Bench, BenchSettings
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


def test_a_raised_alarm_clears_well_on_the_good_side_of_its_limit() -> None:
    watch = alarms()
    seen = [watch.judge(sample_at(round(rate * 0.01))) is not None for rate in (4e5, 6e5, 4e5, 3e5, 2e5, 4e5, 5.1e5)]
    assert seen == [False, True, True, True, False, False, True]


def test_beside_a_point_that_is_skipped_each_is_judged_by_itself() -> None:
    """A screw on the wall says nothing of the wall beside it."""
    watch = alarms(on_count_rate="skip")
    seen = [watch.judge(sample_at(round(rate * 0.01))) is not None for rate in (4e5, 6e5, 4e5, 3e5, 5.1e5, 4.9e5)]
    assert seen == [False, True, False, False, True, False]


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


@pytest.mark.parametrize(("pulses", "stands"), [(84, True), (86, False), (114, False), (116, True)])
def test_a_live_time_in_whole_microseconds_is_no_other_laser(pulses: int, stands: bool) -> None:
    """A hundred are due in ten microseconds, give or take one; beyond that, what is tolerated."""
    assert (alarms().judge(sample_at(0, pulses * 1e5, 1e-5)) is not None) == stands


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
    gated = Alarms(AlarmSettings(expect_direct=False), REPETITION_HZ, expected=Expected(direct=lambda sample: "none"))
    assert gated.judge(sample_at(100)) is None


@pytest.mark.parametrize(
    ("key", "sample"),
    [
        ("on_sync", sample_at(100, sync_hz=8e6)),
        ("on_count_rate", sample_at(9000)),
        (
            "on_count_rate",
            replace(sample_at(1), histogram=replace(sample_at(1).histogram, flags=HistogramFlag.SATURATED)),
        ),
        ("on_direct", sample_at(1)),
    ],
)
def test_each_alarm_does_what_the_scan_file_says_of_it(key: str, sample: Sample) -> None:
    """And not of another one."""
    keys = ("on_sync", "on_count_rate", "on_dark_rate", "on_blank", "on_direct", "on_aim", "on_disk")
    settings_ = AlarmSettings.model_validate({each: "skip" if each == key else "pause" for each in keys})
    direct = (lambda sample: "late") if key == "on_direct" else None
    trouble = Alarms(settings_, REPETITION_HZ, expected=Expected(direct=direct)).judge(sample)
    assert trouble is not None
    assert trouble.action is Action.SKIP


def test_no_photons_where_there_were_some_is_noticed_only_when_it_cannot_be_chance() -> None:
    watch = alarms()
    assert all(watch.judge(sample_at(3)) is None for _ in range(50))
    blanks = [watch.judge(sample_at(0)) for _ in range(10)]
    assert [trouble is not None for trouble in blanks] == [False] * 8 + [True] * 2
    assert watch.judge(sample_at(3)) is None
    dark = alarms()
    assert all(dark.judge(sample_at(0)) is None for _ in range(1000))


@pytest.mark.parametrize("key", ["on_dark_rate", "on_aim", "on_blank"])
def test_so_do_those_of_the_dark_and_of_no_light_at_all(key: str) -> None:
    keys = ("on_sync", "on_count_rate", "on_dark_rate", "on_blank", "on_direct", "on_aim", "on_disk")
    chosen = {each: "skip" if each == key else "pause" for each in keys}
    settings_ = AlarmSettings.model_validate({**chosen, "max_dark_hz": 10.0 if key == "on_dark_rate" else None})
    watch = Alarms(settings_, REPETITION_HZ, expected=Expected(aim="it goes elsewhere" if key == "on_aim" else ""))
    counter = SimpleNamespace(rates=lambda: CountRates(REPETITION_HZ, 50.0))
    bench = cast(Bench, SimpleNamespace(counter=counter, settings=SimpleNamespace(shutter_on="counter")))
    trouble = watch.before(bench)
    for photons in [100] * 10 + [0] * 10 if key == "on_blank" else []:
        trouble = watch.judge(sample_at(photons))
    assert trouble is not None
    assert trouble.action is Action.SKIP
    assert (watch.before(bench) is None) == (key != "on_dark_rate")  # an aim is said once: who goes on has decided


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
