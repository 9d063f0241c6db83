"""Light that was asked for, on the simulated table's own clock: for how long, at what duty, how late, every end, and
what is counted in it."""

import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from nlos.by_hand.light import LightOnRequest
from nlos.by_hand.stops import Stops
from nlos.by_hand.watching import Watch
from nlos.configs.load import load
from nlos.drivers.alignment_settings import AlignmentSettings
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.errors import DeviceError, LimitError, SafetyTrip, ShutterHeld
from nlos.drivers.events import EventLog
from nlos.drivers.partial_bench import PartialBench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.tcspc.axes import whole_period
from tests.nlos.by_hand.witness import bench_file

TICK_S, SPARE_S = 0.01, 0.06
NEAR_S = 0.012
"""One look, and what a command takes on its way."""
TTL: dict[str, dict[str, object]] = {"shutter": {"model": "triggerscope_ttl"}, "mirror": {"shutter_pin": 16}}
LOOKS_AFTER = pytest.mark.parametrize("shutter", [{}, TTL], ids=["with a watchdog", "without"])


class ByHand:
    """A table and its light; a look every 10 ms, as `nlos jog` has it."""

    def __init__(self, bench: Bench, **alignment: float) -> None:
        assert bench.simulated is not None
        self.bench, self.clock, self.table = bench, bench.clock, bench.simulated
        self.light = LightOnRequest(bench.shutter, bench.clock, AlignmentSettings(**alignment), Stops())
        self.began_s = bench.clock.now()
        self.lit: list[list[float]] = []
        """From when to when the table saw light, in seconds since it was opened."""
        self.told: list[str] = []
        self.table.witness = self._seen
        bench.on_event = lambda kind, text: self.told.append(text)

    def _seen(self, when_s: float, what: str) -> None:
        if what == "shutter open":
            self.lit.append([when_s - self.began_s])
        elif what == "shutter closed" and self.lit and len(self.lit[-1]) == 1:
            self.lit[-1].append(when_s - self.began_s)

    def now(self) -> float:
        return self.clock.now() - self.began_s

    def looks_until(self, when_s: float) -> None:
        while self.now() < when_s - 1e-9:
            self.clock.sleep(min(TICK_S, when_s - self.now()))
            self.light.tick()

    def saw(self, *expected: tuple[float, float]) -> None:
        assert self.lit == [pytest.approx(each, abs=NEAR_S) for each in expected]
        assert self.light.on_s == pytest.approx(sum(end - start for start, end in expected), abs=2 * NEAR_S)
        assert self.light.openings == len(expected)
        assert not self.table.shutter_open


class Timer:
    """The computer's, on the table's clock: rings while the program waits for something else than the light."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.set_s: list[float] = []
        monkeypatch.setattr(signal, "setitimer", lambda which, seconds: self.set_s.append(seconds))

    @property
    def is_set(self) -> bool:
        return bool(self.set_s and self.set_s[-1])

    def rings(self, by_hand: ByHand, late_s: float = 0.0) -> None:
        by_hand.clock.sleep(self.set_s[-1] + late_s)
        signal.raise_signal(signal.SIGALRM)


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Callable[..., ByHand]]:
    """`opened(changes, **alignment)`: a table, open until the test ends."""
    benches: list[Any] = []

    def opens(changes: dict[str, dict[str, object]] | None = None, **alignment: float) -> ByHand:
        benches.append(open_bench(load("bench", str(bench_file(tmp_path, changes)), BenchSettings).settings))
        return ByHand(benches[-1].__enter__(), **alignment)

    yield opens
    for bench in benches:
        bench.__exit__(None, None, None)


@pytest.fixture
def timer(monkeypatch: pytest.MonkeyPatch) -> Timer:
    return Timer(monkeypatch)


@LOOKS_AFTER
def test_it_goes_off_just_before_its_time_whatever_watches_it(
    opened: Callable[..., ByHand], shutter: dict[str, dict[str, object]]
) -> None:
    """For longer than `safety.watchdog_s`, with nothing said to an instrument meanwhile."""
    by_hand = opened(shutter)
    assert not by_hand.light.wanted
    assert by_hand.light.ask(3.0)
    by_hand.looks_until(1.0)
    assert by_hand.light.lit
    assert by_hand.light.left_s == pytest.approx(2.0, abs=NEAR_S)
    assert by_hand.light.on_s == pytest.approx(1.0, abs=NEAR_S)
    by_hand.looks_until(5.0)
    assert (by_hand.light.lit, by_hand.light.wanted, by_hand.light.left_s) == (False, False, 0.0)
    by_hand.saw((0.0, 3.0 - SPARE_S))
    assert by_hand.told[-1] == "closed: its time is over"


def test_a_duty_is_kept_from_when_it_was_first_asked_for_and_its_last_flash_ends_with_the_time(
    opened: Callable[..., ByHand],
) -> None:
    by_hand = opened(duty=0.3, period_s=0.5)
    by_hand.looks_until(0.2)
    by_hand.light.ask(0.8)
    by_hand.looks_until(0.65)  # in the dark part
    by_hand.light.ask(0.6)
    assert by_hand.light.wanted
    assert not by_hand.light.lit
    by_hand.looks_until(2.0)
    by_hand.saw((0.2, 0.35 - SPARE_S), (0.7, 0.85 - SPARE_S))
    by_hand.light.ask(0.6)  # over by then: a new beginning
    by_hand.looks_until(4.0)
    by_hand.saw((0.2, 0.29), (0.7, 0.79), (2.0, 2.09), (2.5, 2.6 - SPARE_S))


def test_asked_for_again_it_stays_on_and_no_shorter_wish_takes_any_away(opened: Callable[..., ByHand]) -> None:
    by_hand = opened()
    by_hand.light.ask(1.0)
    by_hand.looks_until(0.5)
    by_hand.light.ask(0.2)
    by_hand.looks_until(0.8)
    assert by_hand.light.lit
    by_hand.light.ask(1.2)
    by_hand.looks_until(3.0)
    by_hand.saw((0.0, 2.0 - SPARE_S))


def test_a_time_outside_the_limits_is_refused_with_nothing_on(opened: Callable[..., ByHand]) -> None:
    by_hand = opened(longest_s=2.0)
    for seconds in (0.2, 2.0):
        by_hand.light.check(seconds)
    for seconds in (0.199, 2.001, float("nan"), float("inf")):
        with pytest.raises(LimitError, match=r"is outside 0\.2 to 2 s\. Ask for less, or change alignment\.longest_s"):
            by_hand.light.ask(seconds)
    nobodys = LightOnRequest(None, by_hand.clock, AlignmentSettings(), Stops())
    with pytest.raises(LimitError, match="what drives it does not answer: no light"):
        nobodys.ask(1.0)
    nobodys.tick()
    nobodys.end("there was none")
    assert not nobodys.lit
    by_hand.saw()


@pytest.mark.parametrize(("late_s", "refused"), [(0.4, False), (0.6, True)])
@pytest.mark.parametrize("duty", [1.0, 0.5])
def test_light_that_goes_off_long_after_its_time_is_told_once(
    opened: Callable[..., ByHand], late_s: float, refused: bool, duty: float
) -> None:
    by_hand = opened(duty=duty, period_s=2.0)
    by_hand.light.ask(1.0)
    by_hand.clock.sleep(1.0 + late_s)
    by_hand.light.tick()
    assert not by_hand.light.lit
    if refused:
        with pytest.raises(SafetyTrip, match=r"closed 0\.6 s after its time: the program was stopped meanwhile"):
            by_hand.light.answer()
    by_hand.light.answer()
    by_hand.looks_until(2.0)
    by_hand.saw((0.0, 1.0 + late_s))


def test_nobody_who_looks_after_light_for_too_long_finds_it_off_and_is_told(opened: Callable[..., ByHand]) -> None:
    """On a shutter that no instrument watches."""
    by_hand = opened(TTL)
    by_hand.light.ask(10.0)
    by_hand.clock.sleep(2.5)
    for look in (by_hand.light.answer, by_hand.light.tick):
        with pytest.raises(SafetyTrip, match="nothing was heard from this program for 2 s"):
            look()
    by_hand.light.end("it hung")
    by_hand.light.ask(1.0)  # a person asks again
    by_hand.looks_until(5.0)
    assert len(by_hand.lit) == 2


@LOOKS_AFTER
@pytest.mark.parametrize("rings_late_s", [0.0, 0.8])
def test_the_timer_shuts_it_where_nobody_looks(
    opened: Callable[..., ByHand], timer: Timer, shutter: dict[str, dict[str, object]], rings_late_s: float
) -> None:
    by_hand, before = opened(shutter), signal.getsignal(signal.SIGALRM)
    with by_hand.light.timed():
        assert not timer.is_set
        by_hand.light.ask(1.0)
        timer.rings(by_hand, rings_late_s)
        by_hand.saw((0.0, 0.97 + rings_late_s))
        assert by_hand.told[-1] == "closed: its time is over"
        if rings_late_s > 0.5:
            with pytest.raises(SafetyTrip, match=r"closed 0\.8 s after its time"):
                by_hand.light.tick()
        by_hand.light.tick()
        signal.raise_signal(signal.SIGALRM)  # one that comes too late finds nothing to do, and nothing late
        by_hand.light.answer()
    assert signal.getsignal(signal.SIGALRM) is before
    assert not timer.is_set


def test_the_timer_moves_with_the_time_and_is_off_with_the_light(opened: Callable[..., ByHand], timer: Timer) -> None:
    by_hand = opened(duty=0.5, period_s=1.0)
    with by_hand.light.timed():
        by_hand.light.ask(1.3)
        assert timer.set_s[-1] == pytest.approx(0.47, abs=NEAR_S)
        by_hand.looks_until(0.2)
        assert timer.set_s[-1] == pytest.approx(0.27, abs=NEAR_S)
        by_hand.looks_until(0.6)
        assert not timer.is_set
        by_hand.looks_until(1.1)
        assert timer.set_s[-1] == pytest.approx(0.17, abs=NEAR_S)
        by_hand.light.end("it was enough")
        assert not timer.is_set
        by_hand.light.ask(0.2)
    assert not timer.is_set  # the block is left with the light on: whoever leaves it ends it
    by_hand.light.tick()
    assert not timer.is_set  # nobody would hear it
    by_hand.light.end("it was enough")


def test_the_timer_rings_again_until_the_shutter_is_closed(opened: Callable[..., ByHand], timer: Timer) -> None:
    by_hand = opened(TTL)
    with by_hand.light.timed():
        by_hand.light.ask(1.0)
        by_hand.table.faults.add(Fault(name="G9", after_s=by_hand.clock.now(), times=2))
        timer.rings(by_hand)
        while by_hand.table.shutter_open:
            assert timer.set_s[-1] == 0.05
            timer.rings(by_hand)
        assert [each.partition(":")[0] for each in by_hand.told[-2:]] == ["NOT CONFIRMED CLOSED", "closed"]
        with pytest.raises(SafetyTrip, match=r"closed \d\.\d s after .*, because at first it did not close: .* port"):
            by_hand.light.tick()
        by_hand.light.end("it was told")
        by_hand.light.ask(1.0)  # another light, which is late for another reason
        by_hand.clock.sleep(1.8)
        by_hand.light.tick()
        with pytest.raises(SafetyTrip, match=r"closed 0\.8 s after its time: the program was stopped"):
            by_hand.light.answer()


def test_another_thread_has_no_timer(opened: Callable[..., ByHand], timer: Timer) -> None:
    by_hand = opened()

    def in_a_thread() -> None:
        with by_hand.light.timed():
            by_hand.light.ask(1.0)
            by_hand.looks_until(2.0)

    thread = threading.Thread(target=in_a_thread)
    thread.start()
    thread.join()
    assert not timer.set_s
    by_hand.saw((0.0, 1.0 - SPARE_S))


def test_a_shutter_that_does_not_close_is_told_and_tried_at_every_look(opened: Callable[..., ByHand]) -> None:
    by_hand = opened(TTL)
    by_hand.light.ask(1.0)
    by_hand.table.faults.add(Fault(name="G9", after_s=by_hand.clock.now(), times=2))
    failed = 0
    while by_hand.light.lit:
        try:
            by_hand.looks_until(by_hand.now() + TICK_S)
        except DeviceError:
            failed += 1
    assert failed == 1
    assert not by_hand.table.shutter_open
    assert by_hand.light.on_s == pytest.approx(by_hand.lit[0][1], abs=NEAR_S)


def test_whatever_was_asked_for_its_end_is_dark_and_says_why(opened: Callable[..., ByHand]) -> None:
    by_hand = opened()
    by_hand.light.ask(10.0)
    by_hand.looks_until(0.5)
    by_hand.light.end("nobody is there any more")
    by_hand.clock.sleep(1.0)
    assert by_hand.light.on_s == pytest.approx(0.5, abs=NEAR_S)
    assert by_hand.told[-1] == "closed: nobody is there any more"
    said = len(by_hand.told)
    by_hand.looks_until(1.5)
    by_hand.light.end("nobody is there any more")  # who is in the dark closes nothing
    assert len(by_hand.told) == said
    by_hand.saw((0.0, 0.5))


def test_in_the_dark_its_end_says_nothing_to_an_instrument_that_may_be_gone(opened: Callable[..., ByHand]) -> None:
    by_hand = opened(TTL)
    by_hand.light.ask(0.5)
    by_hand.looks_until(1.0)
    by_hand.table.faults.add(Fault(name="G9", after_s=by_hand.clock.now(), times=2))
    by_hand.light.end("nobody is there any more")
    with pytest.raises(DeviceError):
        by_hand.bench.shutter.close()  # the fault is there


def test_light_that_a_signal_shut_comes_back_only_to_who_asks_once_that_is_over(opened: Callable[..., ByHand]) -> None:
    by_hand = opened()
    by_hand.light.ask(1.0)
    by_hand.looks_until(0.5)
    by_hand.bench.shutter.hold("SIGUSR1")
    with pytest.raises(ShutterHeld, match="stays closed after SIGUSR1"):
        by_hand.light.tick()
    with pytest.raises(ShutterHeld):
        by_hand.light.ask(0.2)  # its time is not over
    by_hand.light.end("a signal came")
    by_hand.light.ask(1.0)
    assert by_hand.light.lit
    by_hand.light.end("it was enough")
    assert [end - start for start, end in by_hand.lit] == [pytest.approx(0.5, abs=NEAR_S), pytest.approx(0, abs=NEAR_S)]


def test_a_trip_gives_no_light_to_who_asks_again(opened: Callable[..., ByHand]) -> None:
    by_hand = opened()
    by_hand.light.ask(1.0)
    with pytest.raises(SafetyTrip):
        by_hand.bench.shutter.trip("too bright")
    for _ in range(2):
        with pytest.raises(SafetyTrip, match="too bright"):
            by_hand.light.ask(1.0)
        by_hand.light.end("a trip")
    assert len(by_hand.lit) == 1
    assert not by_hand.table.shutter_open


@pytest.mark.parametrize("broken_off", [True, False])
def test_its_time_begins_after_the_warning_and_who_breaks_that_off_has_none(
    opened: Callable[..., ByHand], broken_off: bool
) -> None:
    by_hand = opened({"arm": {"delay_s": 5.0, "remote": True}})
    looks = iter([False] * 20 + [broken_off] * 100)
    by_hand.light.broken_off = lambda: next(looks)
    assert by_hand.light.ask(1.0) is not broken_off
    assert by_hand.light.wanted is not broken_off
    by_hand.looks_until(10.0)
    by_hand.saw(*([] if broken_off else [(5.0, 6.0 - SPARE_S)]))


def test_what_was_counted_in_other_light_at_another_place_or_on_another_axis_is_forgotten(
    opened: Callable[..., ByHand],
) -> None:
    by_hand = opened()
    bench = by_hand.bench
    axis = whole_period(bench.counter, bench.settings.laser.repetition_hz, 0.06)
    partial = PartialBench(bench.settings, bench.clock, EventLog(), counter=bench.counter, shutter=bench.shutter)
    watch = Watch(partial, by_hand.light, axis)
    by_hand.light.ask(1.0)
    assert [watch.look().lit for _ in range(3)] == [True] * 3
    assert watch.summed_s == pytest.approx(0.12, rel=0.01)
    assert len(watch.summed) == round(1 / bench.settings.laser.repetition_hz / axis.bin_width_s)
    by_hand.light.end("it was enough")
    assert watch.look().lit is False
    assert watch.summed_s == pytest.approx(0.04, rel=0.01)
    for changed in (watch.forget, lambda: watch.set_axis(axis)):
        watch.look()
        changed()
        assert (watch.summed_s, int(watch.summed.sum()), watch.peak()) == (0, 0, None)
