"""The timer that ends light by hand, within any message of the shutter's opening and where closing fails at first: it
is dark, by the simulated table's own account."""

import signal
import time
from pathlib import Path

import pytest

from nlos.by_hand.light import LightOnRequest
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.partial_bench import open_partial_bench
from nlos.drivers.simulated.faults import Fault
from tests.acquisition.witnessed_bench import bench_file

BOTH = frozenset({"mirror", "counter"})


class Ringing:
    """Light is asked for, and the timer rings at the `at`-th message of its opening; 0: in its own time."""

    def __init__(self, folder: Path, name: str, at: int) -> None:
        folder.mkdir()
        settings = load("bench", str(bench_file(folder, name)), BenchSettings).settings
        self._at, self._opening, self.messages = at, False, 0
        with open_partial_bench(settings, BOTH, wire_log=self._message) as bench:
            light = LightOnRequest(bench.shutter, bench.clock, settings.alignment)
            with light.timed():
                self._opening = True
                light.ask(1.0)
                self._opening = False
                assert bench.simulated is not None
                assert bench.shutter is not None
                self.told_truly = bench.shutter.may_be_open == bench.simulated.shutter_open
                light.end("it was enough")
                self.dark = not bench.simulated.shutter_open

    def _message(self, device: str, direction: str, data: bytes) -> None:
        if self._opening:
            self.messages += 1
            if self.messages == self._at:
                signal.raise_signal(signal.SIGALRM)


@pytest.mark.parametrize("name", ["S1, TTL shutter", "S2"])
def test_light_whose_time_is_over_while_it_is_switched_on_goes_off(tmp_path: Path, name: str) -> None:
    messages = Ringing(tmp_path / "0", name, 0).messages
    assert messages >= 2
    for at in range(1, messages + 1):
        rung = Ringing(tmp_path / str(at), name, at)
        assert rung.told_truly, at
        assert rung.dark, at


def test_the_timer_rings_again_where_the_shutter_did_not_close(tmp_path: Path) -> None:
    settings = load("bench", str(bench_file(tmp_path, "S1, TTL shutter")), BenchSettings).settings
    with open_partial_bench(settings, BOTH) as bench:
        light = LightOnRequest(bench.shutter, bench.clock, settings.alignment)
        assert bench.simulated is not None
        with light.timed():
            light.ask(0.3)
            bench.simulated.faults.add(Fault(name="G9", after_s=bench.clock.now(), times=2))
            until_s = time.monotonic() + 240
            while bench.simulated.shutter_open and time.monotonic() < until_s:
                time.sleep(0.01)  # as where a terminal takes no more: nobody calls `tick`
            assert not bench.simulated.shutter_open
