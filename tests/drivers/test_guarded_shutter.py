"""The guard around any shutter, call by call: limits to the count, the watchdog's time, and what keeps it closed."""

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from nlos.drivers.clock import VirtualClock
from nlos.drivers.closing import Closing
from nlos.drivers.errors import BenchClosed, DeviceFault, DeviceLost, DeviceTimeout, SafetyTrip, ShutterHeld
from nlos.drivers.events import EventLog
from nlos.drivers.exit_paths import ExitPaths
from nlos.drivers.galvo.mirror import GalvoMirror
from nlos.drivers.safety import GuardedShutter
from nlos.drivers.safety_settings import SafetySettings
from nlos.drivers.shutter import ShutterState
from nlos.drivers.tcspc.counter import CountRates, Histogram, HistogramCounter, HistogramFlag
from nlos.drivers.trip_latch import TripLatch

LIMIT_CPS = 1e5


class Table:
    """A shutter and its counter; both write down what they are told."""

    on_counter = has_watchdog = True

    def __init__(self) -> None:
        self.told: list[Any] = []
        self.while_opening: Callable[[], object] = lambda: None

    def open(self) -> None:
        self.told.append("open")
        self.while_opening()

    def close(self) -> None:
        self.told.append("close")

    def state(self) -> ShutterState:
        return ShutterState(False, None, None)

    def arm_watchdog(self, seconds: float) -> None:
        self.told.append(seconds)

    def clear_trip(self) -> None:
        self.told.append("clear trip")


def guard(table: Table, latch: TripLatch | None = None) -> GuardedShutter:
    settings = SafetySettings(watchdog_s=1.5, trip_cps=LIMIT_CPS, trip_ms=10.0)
    return GuardedShutter(table, cast(HistogramCounter, table), settings, EventLog(), latch)


def counted(total_count: int, live_s: float = 0.01) -> Histogram:
    return Histogram(
        np.zeros(4, np.uint32), 1e-11, 0.0, live_s, round(1e7 * live_s), total_count, HistogramFlag.NONE, 0.0
    )


def test_light_is_watched_from_before_it_comes_on_until_it_is_off() -> None:
    table = Table()
    shutter = guard(table)
    shutter.open()
    shutter.close()
    assert table.told == [1.5, "open", "close", 0.0]
    assert shutter.confirmed_closed
    assert not shutter.may_be_open


def test_the_rate_that_is_allowed_is_allowed_and_one_count_more_trips() -> None:
    table = Table()
    shutter = guard(table)
    shutter.open()
    shutter.watch(counted(1000))
    shutter.watch_rates(CountRates(1e7, LIMIT_CPS))
    with pytest.raises(SafetyTrip, match="closed by a trip"):
        shutter.watch(counted(1001))
    assert table.told[-2:] == ["close", 0.0]
    with pytest.raises(SafetyTrip, match="stays closed after a trip"):
        shutter.open()
    assert table.told[-2:] == ["close", 0.0]
    other = guard(Table())
    with pytest.raises(SafetyTrip, match="closed by a trip"):
        other.watch_rates(CountRates(1e7, 1.001 * LIMIT_CPS))


def test_counts_of_before_the_light_say_nothing_of_it() -> None:
    shutter = guard(Table())
    shutter.open()
    shutter.watch(counted(900, 0.009))
    shutter.close()
    shutter.open()
    shutter.watch(counted(500, 0.001))  # not long enough to be judged by itself


def test_the_first_of_two_trips_is_what_stands(tmp_path: Path) -> None:
    latch, table = TripLatch(tmp_path / "trips.log"), Table()
    shutter = guard(table, latch)
    shutter.latch("too bright")
    shutter.latch("brighter still")
    assert latch.standing() == "too bright"
    assert len(latch.path.read_text().splitlines()) == 1
    with pytest.raises(SafetyTrip, match="too bright"):
        guard(Table(), latch).open()
    shutter.clear_trip("Ada")
    assert table.told[-1] == "clear trip"
    assert latch.standing() is None
    shutter.open()


def test_a_trip_is_on_the_disk_before_anybody_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    latch, synced = TripLatch(tmp_path / "trips.log"), []
    monkeypatch.setattr(os, "fsync", lambda number: synced.append(latch.path.read_text()))
    latch.trip("too bright")
    assert [text.endswith("trip: too bright\n") for text in synced] == [True]


def test_what_a_signal_shut_stays_shut_until_it_is_released() -> None:
    table = Table()
    shutter = guard(table)
    shutter.hold("SIGINT")
    with pytest.raises(ShutterHeld, match="SIGINT"):
        shutter.open()
    assert table.told == ["close"]
    shutter.release()
    shutter.open()
    assert shutter.may_be_open


@pytest.mark.parametrize(("how", "why"), [("held", "SIGTERM"), ("closed", "its time")])
def test_light_that_is_shut_off_while_it_comes_on_goes_off_again(how: str, why: str) -> None:
    """The command to open may have been on its way when that to close was carried out."""
    table = Table()
    shutter = guard(table)
    table.while_opening = shutter.close if how == "closed" else lambda: shutter.hold("SIGTERM")
    with pytest.raises(ShutterHeld, match=f"was closed again after {why}"):
        shutter.open()
    assert [told for told in table.told if isinstance(told, str)] == ["open", "close", "close"]
    assert not shutter.may_be_open


class Stuck(Table):
    """Closes so many times, then not any more; `says` is what the contact is taken for."""

    def __init__(self, closes: int) -> None:
        super().__init__()
        self._left, self.says = closes, "it still says open."

    def close(self) -> None:
        super().close()
        self._left -= 1
        if self._left < 0:
            raise DeviceFault("shutter", self.says, "")


def test_light_that_comes_on_after_the_command_to_close_and_stays_on_is_known_to_be_on() -> None:
    table = Stuck(closes=1)
    shutter = guard(table)
    table.while_opening = shutter.close
    with pytest.raises(DeviceFault, match="still says open"):
        shutter.open()
    assert shutter.may_be_open
    assert not shutter.confirmed_closed


def test_an_interlock_that_refuses_is_told_as_such_also_where_a_signal_came_meanwhile() -> None:
    table = Table()
    shutter = guard(table)

    def refuses() -> None:
        shutter.hold("SIGTERM")
        raise SafetyTrip("shutter", "the interlock is open.", "")

    table.while_opening = refuses
    with pytest.raises(SafetyTrip, match="interlock is open"):
        shutter.open()
    assert not shutter.may_be_open


def test_a_shutter_that_does_not_close_is_told_once_in_the_same_words() -> None:
    table, events, told = Stuck(closes=0), EventLog(), []
    events.listener = lambda kind, text: told.append(text)
    shutter = GuardedShutter(table, None, SafetySettings(), events)
    for table.says in ("it still says open.", "it still says open.", "it does not answer."):
        with pytest.raises(DeviceFault):
            shutter.close()
    assert [each.partition(": ")[0] for each in told] == ["NOT CONFIRMED CLOSED"] * 2
    assert "it does not answer" in told[-1]


def test_a_signal_goes_on_to_what_the_program_does_about_it_although_the_shutter_did_not_close() -> None:
    """An error within its handler would take the signal's place. The way out tries again."""
    table, events = Stuck(closes=0), EventLog()
    closing = Closing(events, VirtualClock())
    closing.shutter = guard(table)
    with ExitPaths(closing.shut_light, lambda: None, closing.may_be_lit), pytest.raises(SystemExit) as ended:
        signal.raise_signal(signal.SIGTERM)
    assert ended.value.code == 128 + signal.SIGTERM
    assert table.told == ["close"]
    assert closing.shutter.is_held()
    assert not events.deferred


class Head:
    """A mirror that writes down what it is told."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def park(self) -> None:
        self.told.append("park")

    def close(self) -> None:
        self.told.append("close")


def test_a_mirror_is_let_go_where_it_is_when_whatever_it_is_breaks_into_the_closing_of_the_light() -> None:
    table, mirror, closing = Table(), Head(), Closing(EventLog(), VirtualClock())
    closing.mirror, closing.shutter = cast(GalvoMirror, mirror), guard(table)
    closing.shutter.open()

    def broken_into() -> None:
        raise KeyboardInterrupt

    table.close = broken_into  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        closing.close()
    assert mirror.told == ["close"]  # the beam moves in the dark alone


def test_a_contact_that_says_open_at_the_end_is_believed_whatever_was_confirmed_before(
    caplog: pytest.LogCaptureFixture,
) -> None:
    table, mirror, closing = Stuck(closes=1), Head(), Closing(EventLog(), VirtualClock())
    closing.mirror, closing.shutter = cast(GalvoMirror, mirror), guard(table)
    closing.shutter.open()
    closing.shutter.close()
    assert closing.shutter.confirmed_closed
    with pytest.raises(DeviceFault, match="still says open"):
        closing.close()
    assert "THE LASER SHUTTER IS NOT CONFIRMED CLOSED" in caplog.text
    assert mirror.told == ["close"]


@pytest.mark.parametrize(("late", "parked"), [(1, True), (3, True), (9, False)])
def test_a_shutter_that_closes_at_a_later_try_is_closed_and_the_beam_parks_in_the_dark(late: int, parked: bool) -> None:
    table, mirror, closing = Table(), Head(), Closing(EventLog(), VirtualClock())
    closing.mirror, closing.shutter = cast(GalvoMirror, mirror), guard(table)
    closing.shutter.open()
    tries = 0

    def close() -> None:
        nonlocal tries
        tries += 1
        if tries <= late:
            raise DeviceTimeout("shutter", "no answer.", "")

    table.close = close  # type: ignore[method-assign]
    with pytest.raises(DeviceTimeout):
        closing.close()
    assert closing.shutter.confirmed_closed == parked
    assert mirror.told == (["park", "close"] if parked else ["close"])
    assert tries == min(late + 1, 5)


class Dead:
    """An instrument whose every step fails in the same words."""

    def park(self) -> None:
        raise DeviceTimeout("link", "no answer.", "")

    close = abort = park


def test_devices_that_fail_every_step_in_the_same_words_are_told_once() -> None:
    events, told = EventLog(), []
    events.listener = lambda kind, text: told.append((kind, text))
    closing = Closing(events, VirtualClock())
    closing.mirror, closing.counter = cast(GalvoMirror, Dead()), cast(HistogramCounter, Dead())
    with pytest.raises(DeviceTimeout):
        closing.close()
    assert [kind for kind, text in told if "no answer" in text] == ["device"]


@pytest.mark.parametrize(("back_after", "dark"), [(1, True), (5, True), (6, False)])
def test_a_cable_that_is_gone_is_looked_for_a_few_times_and_nothing_moves_where_it_stays_away(
    back_after: int, dark: bool
) -> None:
    table, mirror, clock = Table(), Head(), VirtualClock()
    table.on_counter = False  # so no instrument's watchdog is waited for
    closing = Closing(EventLog(), clock)
    closing.mirror, closing.shutter = cast(GalvoMirror, mirror), guard(table)
    closing.shutter.open()
    openings = 0

    def gone() -> None:
        raise DeviceLost("shutter", "its cable is gone.", "")

    def opened_anew() -> None:
        nonlocal openings
        openings += 1
        assert mirror.told == ["close"], "its port has no other name while it is held"
        if openings < back_after:
            gone()

    table.close, closing.make_dark = gone, opened_anew  # type: ignore[method-assign]
    with pytest.raises(DeviceLost):
        closing.close()
    assert openings == min(back_after, 5)
    assert clock.now() == pytest.approx(openings - 1)
    assert ("park" in mirror.told) == dark
    assert mirror.told[-1] == "close"


def test_an_opening_that_fails_is_taken_back() -> None:
    table = Table()
    shutter = guard(table)

    def fails() -> None:
        raise DeviceFault("shutter", "it does not open.", "")

    table.while_opening = fails
    with pytest.raises(DeviceFault, match="does not open"):
        shutter.open()
    assert table.told == [1.5, "open", "close", 0.0]


def test_a_bench_that_was_closed_has_no_more_light() -> None:
    table = Table()
    shutter = guard(table)
    shutter.close_for_good()
    with pytest.raises(BenchClosed):
        shutter.open()
    assert "open" not in table.told


def test_the_watchdogs_time_is_waited_for_and_the_shutters_own() -> None:
    clock, shutter = VirtualClock(), guard(Table())
    assert not shutter.outlast_watchdog(clock)
    shutter.open()
    before_s = clock.now()
    assert shutter.outlast_watchdog(clock)
    assert clock.now() - before_s == pytest.approx(1.6)
    shutter.close()
    assert not shutter.outlast_watchdog(clock)  # it is turned off, and closes nothing any more
