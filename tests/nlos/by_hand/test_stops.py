"""A program with light in its hands that is stopped at a bad moment."""

import os
import time
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from nlos.by_hand.hand import Hand
from nlos.by_hand.keys import Keys
from nlos.by_hand.light import LightOnRequest
from nlos.by_hand.opening import in_hand
from nlos.by_hand.stops import Stops
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.errors import DeviceLost, DeviceTimeout, SafetyTrip
from nlos.drivers.simulated.faults import Fault
from tests.acquisition.witnessed_bench import bench_file, witnessed


@pytest.fixture
def hand_without_timer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AbstractContextManager[Hand]:
    monkeypatch.setattr(LightOnRequest, "_set_timer", lambda *_: None)
    return in_hand(load("bench", str(bench_file(tmp_path, "S2")), BenchSettings), {"mirror"}, 0.2)


def test_an_exchange_that_a_late_end_of_light_cut_in_two_is_no_fault_of_the_instrument(
    hand_without_timer: AbstractContextManager[Hand],
) -> None:
    """The timer of a program that was stopped within an exchange rings as it goes on: one in eight of such stops had
    been told as a cable to check."""
    with pytest.raises(SafetyTrip, match="after its time"):
        cut_in_two(hand_without_timer)


def cut_in_two(in_hand_: AbstractContextManager[Hand]) -> None:
    with in_hand_ as hand:
        hand.ask_for_light(0.2)
        time.sleep(0.9)
        hand.light.tick()
        assert not hand.light.lit
        raise DeviceTimeout("tcspc488", "an urgent command broke into this exchange.")


class BetweenLooks(Stops):
    """Ctrl-Z that comes just after somebody looked whether it had."""

    def __init__(self, hand: Hand) -> None:
        self._hand, self._looks = hand, 0
        self.lit: list[bool] = []
        super().__init__()

    @property
    def wanted(self) -> bool:
        self._looks += 1
        return self._looks == 2

    @wanted.setter
    def wanted(self, _: bool) -> None:
        pass

    def stop(self) -> None:
        self.lit.append(self._hand.light.lit)


def test_no_moment_of_ctrl_z_stops_with_the_light_on(hand_without_timer: AbstractContextManager[Hand]) -> None:
    with hand_without_timer as hand:
        hand.ask_for_light(0.2)
        hand.stops = stops = BetweenLooks(hand)
        assert hand.light.lit
        hand.update()
        assert stops.lit == [False]


class StoppedOnce(Stops):
    """Ctrl-Z has come; the stop itself is only counted."""

    def __init__(self) -> None:
        super().__init__()
        self.wanted, self.times = True, 0

    def stop(self) -> None:
        self.wanted, self.times = False, self.times + 1


def test_a_key_that_is_held_while_ctrl_z_shuts_the_light_does_not_bring_it_back(tmp_path: Path) -> None:
    pressed, presses = os.pipe()
    with (
        os.fdopen(pressed, "rb") as keys,
        os.fdopen(presses, "wb", buffering=0) as finger,
        in_hand(load("bench", str(bench_file(tmp_path, "S2")), BenchSettings), {"mirror"}, 5.0) as hand,
    ):
        hand.ask_for_light(5.0)
        assert hand.light.lit
        hand.keys, hand.stops = Keys(keys.fileno()), (stops := StoppedOnce())
        finger.write(b"   ")
        hand.update()
        assert stops.times == 1
        assert not hand.light.lit
        finger.write(b" ")  # after it: somebody wants light
        hand.update()
    assert witnessed(tmp_path).count("shutter open") == 2


def test_a_mirror_whose_cable_is_pulled_ends_light_by_hand_also_while_nothing_is_said_to_it(tmp_path: Path) -> None:
    table = load("bench", str(bench_file(tmp_path, "S2")), BenchSettings)
    with pytest.raises(DeviceLost):
        pulled(in_hand(table, {"mirror"}, 5.0))
    assert witnessed(tmp_path)[-1] != "shutter open"
    assert "shutter closed" in witnessed(tmp_path)


def pulled(in_hand_: AbstractContextManager[Hand]) -> None:
    with in_hand_ as hand:
        hand.ask_for_light(5.0)
        assert hand.light.lit
        assert hand.bench.simulated is not None
        hand.bench.simulated.faults.add(Fault(name="G8", after_s=hand.bench.clock.now()))
        for _ in range(20):
            hand.update()
        raise AssertionError("nobody looked after the mirror")


def test_light_by_hand_ends_without_a_timer_where_the_system_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("signal.setitimer", raising=False)
    with in_hand(load("bench", str(bench_file(tmp_path, "S2")), BenchSettings), {"mirror"}, 0.2) as hand:
        hand.ask_for_light(0.2)
        assert hand.light.lit
        while hand.light.wanted:
            hand.update()
        assert not hand.light.lit
