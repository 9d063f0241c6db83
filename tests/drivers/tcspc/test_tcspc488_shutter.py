"""A `tcspc488`'s shutter whose blade, contact or cable is not what it should be: what is confirmed, and what is not."""

from collections.abc import Callable
from typing import Any

import pytest

from nlos.drivers.errors import DeviceError, DeviceFault, ProtocolError, SafetyTrip
from nlos.drivers.simulated.faults import Fault

MOVES_S = 0.1
"""Within so long a blade has moved (docs/instruments.md)."""


class Blade:
    """What the drive moves, `late_s` after it is told to; `stuck` at where it is."""

    def __init__(self, this: Any, late_s: float = 0.0) -> None:
        self._bench, self._set = this.bench, this.bench.set_shutter
        self.late_s, self.stuck = late_s, False
        self._due: tuple[float, bool] | None = None
        this.bench.set_shutter = self.drive
        this.bench.ticks(self._come_up)
        said = this.firmware._shutter_state

        def state(argument: bytes) -> bytes:
            self._come_up(self._bench.clock.now())
            return said(argument)

        answers(this, "OUTP:SHUT?", state)

    def drive(self, is_open: bool) -> None:
        self._due = (self._bench.clock.now() + self.late_s, is_open)
        self._come_up(self._bench.clock.now())

    def _come_up(self, now_s: float) -> None:
        if self._due is not None and not self.stuck and now_s >= self._due[0]:
            (_, is_open), self._due = self._due, None
            self._set(is_open)


def answers(this: Any, header: str, answer: Callable[[bytes], bytes]) -> None:
    parser = this.firmware._parser
    parser._handlers[header] = answer
    parser._found.clear()


def says(this: Any, shutter: bytes, interlock: bytes = b"OK") -> None:
    answers(this, "OUTP:SHUT?", lambda argument: shutter)
    answers(this, "INTL?", lambda argument: interlock)


def told(this: Any) -> list[bytes]:
    """What the drive was told, in order."""
    sent = b"".join(data for _, way, data in this.wire if way == ">")
    return [b"OPEN" if sent[at + 10 :].startswith(b"OPEN") else b"CLOS" for at in _places(sent, b"OUTP:SHUT ")]


def _places(sent: bytes, word: bytes) -> list[int]:
    found, at = [], sent.find(word)
    while at >= 0:
        found.append(at)
        at = sent.find(word, at + 1)
    return found


def test_a_blade_that_takes_its_time_is_waited_for_either_way(rig: Callable) -> None:
    this = rig()
    Blade(this, 0.8 * MOVES_S)
    this.shutter.open()
    assert this.bench.shutter_open
    this.shutter.close()
    assert not this.bench.shutter_open


def test_a_blade_that_takes_too_long_to_close_is_not_confirmed_closed(rig: Callable) -> None:
    this = rig()
    this.shutter.open()
    Blade(this, 5 * MOVES_S)
    began_s = this.bench.clock.now()
    with pytest.raises(DeviceFault, match=r"says OPEN after it was told to close\. Switch the laser off by hand"):
        this.shutter.close()
    assert MOVES_S <= this.bench.clock.now() - began_s < 2 * MOVES_S
    assert this.counter.instrument.shutter_opened  # a restart of the counter still matters to it


def test_a_blade_that_does_not_open_is_let_go_again(rig: Callable) -> None:
    this = rig()
    blade = Blade(this)
    blade.stuck = True
    with pytest.raises(DeviceFault, match="does not open"):
        this.shutter.open()
    assert told(this)[-2:] == [b"OPEN", b"CLOS"]
    blade.stuck = False
    this.bench.clock.sleep(1.0)
    blade._come_up(this.bench.clock.now())
    assert not this.bench.shutter_open  # freed later, it stays where it was last told


@pytest.mark.parametrize("shutter", [b"OPEN,CLOS", b"CLOS,OPEN", b"OPEN,OPEN"])
def test_closed_are_drive_and_contact_both_or_it_is_not(rig: Callable, shutter: bytes) -> None:
    """`OPEN,CLOS`: the command did not arrive, and something else holds the blade for now."""
    this = rig()
    says(this, shutter)
    with pytest.raises(DeviceFault, match="after it was told to close"):
        this.shutter.close()


@pytest.mark.parametrize("shutter", [b"OPEN,CLOS", b"CLOS,OPEN"])
def test_open_are_drive_and_contact_both_or_it_is_not(rig: Callable, shutter: bytes) -> None:
    this = rig()
    says(this, shutter)
    with pytest.raises(DeviceFault):
        this.shutter.open()
    assert told(this)[-1] == b"CLOS"


def test_contact_and_drive_are_told_apart(rig: Callable) -> None:
    this = rig()
    says(this, b"OPEN,CLOS", b"OPEN")
    state = this.shutter.state()
    assert (state.commanded_open, state.feedback_open, state.interlock_closed) == (True, False, False)
    says(this, b"CLOS,OPEN")
    state = this.shutter.state()
    assert (state.commanded_open, state.feedback_open, state.interlock_closed) == (False, True, True)


@pytest.mark.parametrize(
    ("shutter", "interlock"), [(b"CLOS", b"OK"), (b"CLOSE,CLOS", b"OK"), (b"CLOS,", b"OK"), (b"CLOS,CLOS", b"1")]
)
def test_an_answer_of_another_kind_confirms_nothing(rig: Callable, shutter: bytes, interlock: bytes) -> None:
    this = rig()
    says(this, shutter, interlock)
    with pytest.raises(ProtocolError, match="answered"):
        this.shutter.close()


def test_an_open_loop_is_seen_before_the_drive_is_told_anything(rig: Callable) -> None:
    this = rig()
    this.bench.interlock_closed = False
    before = told(this)
    with pytest.raises(SafetyTrip, match="the interlock loop is open"):
        this.shutter.open()
    assert told(this) == before


def test_errors_of_others_in_the_queue_do_not_hinder_a_look(rig: Callable) -> None:
    this = rig()
    this.bench.faults.add(Fault(name="U13", parameters={"errors": 2}))
    assert this.shutter.state().feedback_open is False


def test_a_refusal_to_open_that_is_no_trip_is_not_called_one(rig: Callable) -> None:
    """A latched trip keeps a person busy; -200 is an error of execution."""
    this = rig()
    this.bench.faults.add(Fault(name="U13", skip=1, parameters={"errors": 1, "code": -200}))
    with pytest.raises(DeviceError, match="-200") as refused:
        this.shutter.open()
    assert not isinstance(refused.value, SafetyTrip)


def test_a_lost_answer_never_makes_it_open_twice(rig: Callable) -> None:
    """Meanwhile somebody may have closed it."""
    for skip in range(4):
        this = rig(Fault(name="U1", after_s=0.5, skip=skip))
        this.bench.clock.advance_to(0.5)
        try:
            this.shutter.open()
        except DeviceError:
            this.shutter.close()
        assert told(this).count(b"OPEN") == 1


def test_who_restarts_between_two_looks_has_closed_what_was_open(rig: Callable) -> None:
    this = rig()
    assert not this.counter.instrument.shutter_opened
    this.shutter.open()
    assert this.counter.instrument.shutter_opened
    this.shutter.close()
    assert not this.counter.instrument.shutter_opened
