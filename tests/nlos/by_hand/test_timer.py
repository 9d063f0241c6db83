"""The timer that ends light by hand, within any message of the shutter's opening and where closing fails at first: it
is dark, by the simulated table's own account."""

import math
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from nlos.__main__ import run
from nlos.by_hand.light import LightOnRequest
from nlos.by_hand.stops import Stops
from nlos.cli.exit_codes import ExitCode
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.partial_bench import open_partial_bench
from nlos.drivers.simulated.faults import Fault
from tests.acquisition.killed_scans import FORK
from tests.acquisition.witnessed_bench import bench_file, witnessed

BOTH = frozenset({"mirror", "counter"})


class Ringing:
    """Light is asked for, and the timer rings at the `at`-th message of its opening; 0: in its own time."""

    def __init__(self, folder: Path, name: str, at: int) -> None:
        folder.mkdir()
        settings = load("bench", str(bench_file(folder, name)), BenchSettings).settings
        self._at, self._opening, self.messages = at, False, 0
        with open_partial_bench(settings, BOTH, wire_log=self._message) as bench:
            light = LightOnRequest(bench.shutter, bench.clock, settings.alignment, Stops())
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


@pytest.mark.parametrize(("name", "fails"), [("S1, TTL shutter", 0), ("S1, TTL shutter", 2), ("S2", 0)])
def test_the_timer_shuts_it_in_its_time_and_rings_again_where_the_shutter_did_not_close(
    tmp_path: Path, name: str, fails: int
) -> None:
    """As where a terminal takes no more: nobody calls `tick`. No watchdog has to."""
    settings = load("bench", str(bench_file(tmp_path, name)), BenchSettings).settings
    patient = settings.safety.model_copy(update={"watchdog_s": 60.0})
    told: list[str] = []
    before = signal.getsignal(signal.SIGALRM)
    with open_partial_bench(settings.model_copy(update={"safety": patient}), BOTH) as bench:
        bench.events.listener = lambda kind, text: told.append(text)
        light = LightOnRequest(bench.shutter, bench.clock, settings.alignment, Stops())
        assert bench.simulated is not None
        with light.timed():
            light.ask(0.3)
            assert light.lit
            if fails:
                bench.simulated.faults.add(Fault(name="G9", after_s=bench.clock.now(), times=fails))
            until_s = time.monotonic() + 30
            while bench.simulated.shutter_open and time.monotonic() < until_s:
                time.sleep(0.01)
            assert not bench.simulated.shutter_open
    assert signal.getsignal(signal.SIGALRM) is before
    assert "closed: its time is over" in told
    assert any("NOT CONFIRMED CLOSED" in each for each in told) == (fails > 0)


def test_light_that_is_asked_for_again_in_time_goes_on_without_a_gap(tmp_path: Path) -> None:
    """The timer that was set for the first time asked is none of the second's."""
    settings = load("bench", str(bench_file(tmp_path, "S2")), BenchSettings).settings
    with open_partial_bench(settings, BOTH) as bench:
        light = LightOnRequest(bench.shutter, bench.clock, settings.alignment, Stops())
        with light.timed():
            light.ask(1.5)
            again_s = bench.clock.now() + 0.3
            while light.wanted:
                if bench.clock.now() > again_s:
                    light.ask(1.5)
                    again_s = math.inf
                light.tick()
                time.sleep(0.01)
    assert light.on_s > 1.6
    assert witnessed(tmp_path).count("shutter open") == 1


def point_in_a_child(folder: Path) -> None:
    os.chdir(folder)
    os.dup2(os.open("said.txt", os.O_WRONLY | os.O_CREAT), 2)
    sys.stderr = os.fdopen(2, "w")
    code = run(["point", "0.1", "0.1", "--bench", "bench.yaml", "--light", "1"])
    sys.stderr.flush()
    os._exit(code)


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="stops a process")
@pytest.mark.parametrize(
    ("name", "stopped_s", "said"),
    [
        ("S3", 2.5, "nothing was heard from this program for 2 s with the light on"),
        ("S3", 1.6, " s after its time: the program was stopped meanwhile, or the computer slept."),
        ("S2", 1.6, " s after its time: the program was stopped meanwhile, or the computer slept."),
    ],
    ids=["nothing watches", "for less than that", "for less than the watchdog waits"],
)
def test_light_by_hand_that_outlasted_its_time_while_its_program_was_stopped_is_told(
    tmp_path: Path, name: str, stopped_s: float, said: str
) -> None:
    """SIGSTOP and SIGCONT, as of a computer that sleeps. The timer closes it as the program goes on, by when there was
    light for longer than was asked: no success."""
    assert stopped_with_light(tmp_path, name, stopped_s) == ExitCode.REFUSED
    assert "shutter closed" in witnessed(tmp_path)
    assert said in (tmp_path / "said.txt").read_text()


def stopped_with_light(folder: Path, name: str, stopped_s: float) -> int | None:
    """The exit code of a `point` that was stopped for so long with its light on."""
    bench_file(folder, name)
    child, began_s = FORK.Process(target=point_in_a_child, args=(folder,)), time.monotonic()
    child.start()
    try:
        while "shutter open" not in witnessed(folder):
            time.sleep(0.02)
            assert time.monotonic() - began_s < 60
        os.kill(child.pid or 0, signal.SIGSTOP)
        time.sleep(stopped_s)
        assert witnessed(folder)[-1] == "shutter open"
    finally:
        os.kill(child.pid or 0, signal.SIGCONT)
        child.join()
    return child.exitcode
