"""A program with light in its hands that is stopped at a bad moment."""

import time
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from nlos.by_hand.hand import Hand
from nlos.by_hand.light import LightOnRequest
from nlos.by_hand.opening import in_hand
from nlos.by_hand.stops import Stops
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.errors import DeviceTimeout, SafetyTrip
from tests.acquisition.witnessed_bench import bench_file


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
