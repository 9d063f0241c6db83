"""The timer that ends light by hand, within any message of the shutter's opening and of a program that is stopped: it
is dark, by the simulated table's own account."""

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
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.partial_bench import open_partial_bench
from tests.acquisition.killed_scans import FORK
from tests.acquisition.witnessed_bench import bench_file, witnessed

BOTH = frozenset({"mirror", "counter"})
ASKED_S = (0.4, 1.6, 6.4, 25.6)
"""A machine that is busy may not come to what is tested before the light's time is over: then more is asked for."""
PATIENT = ("  watchdog_s: 2.0", "  watchdog_s: 60.0")


class Ringing:
    """Light is asked for, and the timer rings at the `at`-th message of its opening; 0: in its own time."""

    def __init__(self, folder: Path, name: str, at: int) -> None:
        folder.mkdir()
        settings = load("bench", str(bench_file(folder, name)), BenchSettings).settings
        self._at, self._opening, self.messages = at, False, 0
        with open_bench(settings, wire_log=self._message) as bench:
            light = LightOnRequest(bench.shutter, bench.clock, settings.alignment, Stops())
            with light.timed():
                self._opening = True
                light.ask(1.0)
                self._opening = False
                assert bench.simulated is not None
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


def test_the_computers_own_timer_shuts_it_in_its_time(tmp_path: Path) -> None:
    """As where a terminal takes no more: nobody calls `tick`. No watchdog has to."""
    settings = load("bench", str(bench_file(tmp_path, "S1, TTL shutter")), BenchSettings).settings
    patient = settings.safety.model_copy(update={"watchdog_s": 60.0})
    told: list[str] = []
    before = signal.getsignal(signal.SIGALRM)
    with open_partial_bench(settings.model_copy(update={"safety": patient}), BOTH) as bench:
        bench.events.listener = lambda kind, text: told.append(text)
        light = LightOnRequest(bench.shutter, bench.clock, settings.alignment, Stops())
        assert bench.simulated is not None
        with light.timed():
            light.ask(0.3)
            until_s = time.monotonic() + 60
            while bench.simulated.shutter_open and time.monotonic() < until_s:
                time.sleep(0.01)
            assert not bench.simulated.shutter_open
    assert signal.getsignal(signal.SIGALRM) is before
    assert (
        "closed: its time is over" in told or not light.openings
    )  # whose time was over before a busy machine came to it


def point_in_a_child(folder: Path, light_s: float) -> None:
    os.chdir(folder)
    os.dup2(os.open("said.txt", os.O_WRONLY | os.O_CREAT), 2)
    sys.stderr = os.fdopen(2, "w")
    code = run(["point", "0.1", "0.1", "--bench", "bench.yaml", "--light", str(light_s)])
    sys.stderr.flush()
    os._exit(code)


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="stops a process")
@pytest.mark.parametrize(
    ("name", "watchdog", "said"),
    [
        ("S3", (), "nothing was heard from this program for 2 s with the light on"),
        ("S2", PATIENT, " s after its time: the program was stopped meanwhile, or the computer slept."),
    ],
    ids=["nothing watches", "for less than the watchdog waits"],
)
def test_light_by_hand_that_outlasted_its_time_while_its_program_was_stopped_is_told(
    tmp_path: Path, name: str, watchdog: tuple[str, ...], said: str
) -> None:
    """SIGSTOP and SIGCONT, as of a computer that sleeps. The timer closes it as the program goes on, by when there was
    light for longer than was asked: no success."""
    for number, seconds in enumerate(ASKED_S[1:]):
        folder = tmp_path / str(number)
        folder.mkdir()
        path = bench_file(folder, name)
        path.write_text(path.read_text().replace(*watchdog) if watchdog else path.read_text())
        code = stopped_with_light(folder, seconds)
        if code is not None:
            break
    assert code == ExitCode.REFUSED
    assert "shutter closed" in witnessed(folder)
    assert said in (folder / "said.txt").read_text()


def stopped_with_light(folder: Path, light_s: float) -> int | None:
    """The exit code of a `point` that was stopped with its light on for longer than that was to last; None where it
    came to be stopped too late."""
    child, began_s = FORK.Process(target=point_in_a_child, args=(folder, light_s)), time.monotonic()
    child.start()
    try:
        while "shutter open" not in witnessed(folder):
            time.sleep(0.02)
            assert time.monotonic() - began_s < 60
        os.kill(child.pid or 0, signal.SIGSTOP)
        time.sleep(light_s + 1.0)
        in_time = witnessed(folder)[-1] == "shutter open"
    finally:
        os.kill(child.pid or 0, signal.SIGCONT)
        child.join()
    return child.exitcode if in_time else None
