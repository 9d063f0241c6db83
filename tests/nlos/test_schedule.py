"""When a picture in passing is made, and by which method, told by a clock that stands still unless it is moved."""

from types import SimpleNamespace

import pytest

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.live import schedule as scheduling
from nlos.live.schedule import EVERY_S, QUICK_AFTER_S, ROOM, Schedule

PLANNED = 1000


class Clock:
    now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(scheduling, "time", SimpleNamespace(monotonic=clock.monotonic))
    return clock


def come(schedule: Schedule, clock: Clock, each_second: int = 100) -> None:
    """So many samples in the second before now."""
    for number in range(each_second):
        schedule.pace.saw(clock.now_s - 1 + number / each_second)


def under_way(schedule: Schedule, count: int) -> str | None:
    return schedule.due(count, PLANNED, True, False)


def test_the_quickest_comes_first_and_the_best_after_it(clock: Clock) -> None:
    schedule = Schedule(["lct", "nano"], 0.1)
    come(schedule, clock)
    assert under_way(schedule, 0) is None
    assert under_way(schedule, 99) is None
    assert under_way(schedule, 100) == "lct"
    schedule.made("lct", 100, PLANNED, 0.1, True)
    assert under_way(schedule, 100) == "nano"
    schedule.made("nano", 100, PLANNED, 1.0, True)
    assert under_way(schedule, 149) is None
    assert under_way(schedule, 150) == "nano"  # the quick one is silent while the best one is quick as well


def test_where_the_best_is_slow_whoever_waited_longest_is_next(clock: Clock) -> None:
    schedule = Schedule(["lct", "nano"], 0.1)
    come(schedule, clock, 20)
    under_way(schedule, 0)
    schedule.made("nano", 100, PLANNED, QUICK_AFTER_S, True)
    clock.now_s += 0.5
    schedule.made("lct", 100, PLANNED, 0.1, True)
    assert under_way(schedule, 150) == "nano"
    schedule.begun("nano", 150, PLANNED, True)
    assert under_way(schedule, 150) == "lct"


def test_a_new_one_is_due_after_a_while_only_where_something_came(clock: Clock) -> None:
    schedule = Schedule(["lct"], 0.1)
    schedule.made("lct", 100, PLANNED, 0.1, True)
    clock.now_s += EVERY_S - 0.01
    come(schedule, clock)
    assert under_way(schedule, 101) is None
    clock.now_s += 0.02
    assert under_way(schedule, 100) is None
    assert under_way(schedule, 101) == "lct"


def test_nothing_is_begun_that_would_not_be_there_before_the_last_sample(clock: Clock) -> None:
    schedule = Schedule(["lct"], 0.1)
    schedule.made("lct", 100, PLANNED, 2.0, True)
    come(schedule, clock)  # 10 ms each
    left = round(100 * 2.0 * ROOM)
    assert under_way(schedule, PLANNED - left - 10) == "lct"
    assert under_way(schedule, PLANNED - left + 10) is None


def test_at_the_end_every_method_makes_its_picture_of_all(clock: Clock) -> None:
    schedule = Schedule(["lct", "nano"], 0.1)
    under_way(schedule, 0)
    for method in ("lct", "nano"):
        assert not schedule.done(900)
        assert schedule.due(900, PLANNED, True, True) == method
        schedule.made(method, 900, PLANNED, 0.1, True)
        clock.now_s += 1
    assert schedule.due(900, PLANNED, True, True) is None
    assert schedule.done(900)


def test_of_a_finished_recording_there_is_one_picture_and_none_was_skipped(clock: Clock) -> None:
    schedule = Schedule(["lct"], 0.1)
    come(schedule, clock)
    assert schedule.due(500, PLANNED, False, False) is None
    assert schedule.due(PLANNED, PLANNED, False, True) == "lct"
    schedule.made("lct", PLANNED, PLANNED, 0.1, False)
    assert schedule.skipped == 0


def test_what_comes_next_and_when_is_told(clock: Clock) -> None:
    schedule = Schedule(["lct", "nano"], 0.1)
    silent = schedule.coming(0, PLANNED, True, False)
    assert (silent.samples, silent.in_s) == (100, None)  # nobody can tell
    come(schedule, clock)
    first = schedule.coming(50, PLANNED, True, False)
    assert (first.method, first.samples, first.making, first.in_s) == ("lct", 100, False, pytest.approx(0.5))
    schedule.made("lct", 100, PLANNED, 0.25, True)
    later = schedule.coming(110, PLANNED, True, False)
    assert (later.samples, later.in_s) == (150, pytest.approx(0.4 + 0.25))
    schedule.made("lct", 980, PLANNED, 0.25, True)
    assert schedule.coming(990, PLANNED, True, False).samples == PLANNED
    assert schedule.coming(700, PLANNED, False, False).samples == PLANNED
    last = schedule.coming(990, PLANNED, True, True)  # it ended early
    assert (last.samples, last.in_s) == (990, pytest.approx(0.25))


def test_of_a_film_the_first_picture_is_of_a_whole_scan_of_the_wall(clock: Clock) -> None:
    words = {"wall": {"width_m": 1.0, "height_m": 1.0, "rows": 8, "cols": 8}, "pattern": "serpentine", "dwell_ms": 1,
             "frames": 10, "interleave": 2, "histogram": {"bins": 64, "bin_width_ps": 256}}  # fmt: skip
    plan = ScanSettings.model_validate(words).plan()
    schedule = Schedule(["lct"], 0.05)
    schedule.follow_frames(plan)
    come(schedule, clock, 64)
    assert schedule.frame_s() == pytest.approx(len(plan) / plan.frames / 64)
    assert schedule.due(63, len(plan), True, False) is None
    assert schedule.due(64, len(plan), True, False) == "lct"
