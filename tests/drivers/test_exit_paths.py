"""However a program ends while it scans: the shutter closes before anything else is sent, then the mirror parks."""

import ast
import os
import re
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable
from pathlib import Path

import pytest

from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.exit_paths import ExitPaths, close_benches, undisturbed
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.tcspc488.firmware import Tcspc488Firmware

CHILD = Path(__file__).parent / "scanning_child.py"


def end_by(ending: str, *signals: signal.Signals) -> tuple[int, list[str], list[str]]:
    """Exit code, what was sent before the end began, what was sent after."""
    child = subprocess.Popen(
        [sys.executable, str(CHILD), ending],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "scanning\n"
    for number in signals:
        child.send_signal(number)
    _, log = child.communicate(timeout=240)
    lines = log.splitlines()
    middle = lines.index("EVENT")
    return child.returncode, lines[:middle], lines[middle + 1 :]


def commands(lines: list[str]) -> list[str]:
    """What each line asks of a device, without USBTMC headers and requests."""
    asked = [re.search(r"(OUTP:SHUT CLOS|ABOR|SAO\d-\d+|SAR\d-4|SYST:WDOG 0)", line) for line in lines]
    return [found.group(1) for found in asked if found]


def check_order(lines: list[str]) -> None:
    """From the first closing of the shutter on: no opening, the gate stopped, and no move but the two to the centre."""
    closing = next(index for index, line in enumerate(lines) if "OUTP:SHUT CLOS" in line)
    after = commands(lines[closing:])
    assert not any("OUTP:SHUT OPEN" in line for line in lines[closing:])
    assert [command for command in after if command.startswith("SAO")] == ["SAO1-32767", "SAO2-32767"]
    assert "ABOR" in after


@pytest.mark.parametrize(("ending", "code"), [("exit", 7), ("exception", 1), ("forgotten", 0)])
def test_an_exit_an_exception_and_a_forgotten_bench_close_the_light_first(ending: str, code: int) -> None:
    returned, _, after = end_by(ending)
    assert returned == code
    assert commands(after)[0] == "OUTP:SHUT CLOS"
    check_order(after)


@pytest.mark.parametrize(("name", "codes"), [("SIGINT", (-2, 130)), ("SIGTERM", (143,)), ("SIGHUP", (129,))])
def test_a_signal_closes_the_light_whatever_the_link_is_doing(name: str, codes: tuple[int, ...]) -> None:
    if not hasattr(signal, name):
        pytest.skip(f"there is no {name} here")
    returned, _, after = end_by("signal", signal.Signals[name])
    assert returned in codes
    check_order(after)


def test_a_second_interrupt_does_not_cut_the_closing_short() -> None:
    returned, _, after = end_by("signal", signal.SIGINT, signal.SIGINT, signal.SIGINT, signal.SIGTERM)
    assert returned != 0
    check_order(after)


def test_a_signal_sent_from_another_thread_ends_the_scan_in_the_same_way() -> None:
    returned, _, after = end_by("thread")
    assert returned == 143
    check_order(after)


def test_a_handler_that_was_there_before_is_called_after_the_light_is_shut_and_restored() -> None:
    happened: list[str] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: happened.append("earlier handler"))
    try:
        handler, hook = signal.getsignal(signal.SIGINT), sys.unraisablehook
        with ExitPaths(lambda why: happened.append(f"light {why}"), lambda: happened.append("closed")):
            signal.raise_signal(signal.SIGINT)
            assert happened == ["light SIGINT", "earlier handler"]
        assert signal.getsignal(signal.SIGINT) is handler
        assert sys.unraisablehook is hook
    finally:
        signal.signal(signal.SIGINT, before)
    assert happened[2:] == ["closed"]


def test_nobody_is_told_within_a_signals_handler_and_everything_is_told_afterwards() -> None:
    """Files are not safe to write there: whoever writes the recording may be in the middle of a line."""
    told: list[tuple[str, str]] = []
    told_by_then: list[list[tuple[str, str]]] = []
    before = signal.signal(signal.SIGUSR1, lambda number, frame: told_by_then.append(list(told)))
    try:
        with open_bench(load("bench", "simulated", BenchSettings).settings) as bench:
            bench.on_event = lambda kind, text: told.append((kind, text))
            bench.shutter.open()
            told.clear()
            signal.raise_signal(signal.SIGUSR1)
            assert not bench.shutter.may_be_open
            assert told_by_then == [[]]
            bench.report("scan", "goes on")
            assert told == [("signal", "SIGUSR1"), ("shutter", "closed: SIGUSR1"), ("scan", "goes on")]
    finally:
        signal.signal(signal.SIGUSR1, before)


def test_a_signal_while_closing_waits_until_everything_is_closed() -> None:
    happened: list[str] = []

    def close() -> None:
        signal.raise_signal(signal.SIGTERM)
        happened.append("closed")

    with pytest.raises(SystemExit) as exit_, ExitPaths(lambda why: happened.append("light"), close):
        pass
    assert exit_.value.code == 143
    assert happened == ["closed"]


def test_an_ignored_signal_stays_ignored() -> None:
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with ExitPaths(lambda why: pytest.fail("not asked to shut the light"), lambda: None):
            signal.raise_signal(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_killed_program_leaves_the_light_to_the_watchdog(dark_bench: Callable[..., SimulatedBench]) -> None:
    """What it had sent until it was killed is sent to an instrument here, and then nothing more."""
    returned, before, after = end_by("signal", signal.SIGKILL)
    assert returned == -signal.SIGKILL
    bench = dark_bench()
    instrument = Tcspc488Firmware(bench)
    for line in before + after:
        device, _, data = line.partition(" ")
        transfer = ast.literal_eval(data) if device == "tcspc488" and data.endswith("'") else b""
        if transfer[:1] == b"\x01":  # DEV_DEP_MSG_OUT
            size = int.from_bytes(transfer[4:8], "little")
            instrument.execute(transfer[12 : 12 + size], bench.clock.now())
    assert bench.shutter_open
    bench.clock.sleep(1.0)
    instrument.advance(bench.clock.now())
    assert bench.shutter_open
    bench.clock.sleep(1.5)
    instrument.advance(bench.clock.now())
    assert not bench.shutter_open


class Finalised:
    """Its finaliser takes long enough for a signal to come."""

    def __init__(self, *numbers: int) -> None:
        self._numbers = numbers

    def __del__(self) -> None:
        for number in self._numbers:
            signal.raise_signal(number)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_an_end_that_falls_into_a_finaliser_comes_again_and_prints_nothing(
    number: signal.Signals, capfd: pytest.CaptureFixture[str]
) -> None:
    happened: list[str] = []
    with (  # noqa: PT012
        pytest.raises(SystemExit) as exit_,
        ExitPaths(happened.append, lambda: happened.append("closed")),
    ):
        Finalised(number)
        time.sleep(5)
        pytest.fail("the signal was lost")
    assert exit_.value.code == 128 + number
    assert happened == [number.name, number.name, "closed"]
    assert capfd.readouterr().err == ""


def test_what_else_fails_in_a_finaliser_is_told_to_whom_it_was_before(monkeypatch: pytest.MonkeyPatch) -> None:
    lost: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda told: lost.append(told.exc_value))
    before, error = sys.unraisablehook, ValueError("not the end")

    def fails(_: object) -> None:
        raise error

    with ExitPaths(lambda why: None, lambda: None):
        kept = Finalised()
        watched = weakref.ref(kept, fails)
        del kept
    assert watched() is None
    assert lost == [error]
    assert sys.unraisablehook is before


def test_an_interrupt_that_falls_into_a_weak_references_callback_comes_again() -> None:
    happened: list[str] = []
    kept = Finalised()
    watched = weakref.ref(kept, lambda reference: signal.raise_signal(signal.SIGINT))
    with (  # noqa: PT012
        pytest.raises(KeyboardInterrupt),
        ExitPaths(happened.append, lambda: happened.append("closed")),
    ):
        del kept
        time.sleep(5)
        pytest.fail("the signal was lost")
    assert watched() is None
    assert happened[-1] == "closed"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks a process")
def test_a_child_that_was_forked_ends_by_its_signal_and_leaves_the_bench_to_its_parent() -> None:
    happened: list[str] = []
    with ExitPaths(happened.append, lambda: happened.append("closed")) as paths:
        child = os.fork()
        if not child:
            code = 1  # nobody ended it
            try:
                signal.raise_signal(signal.SIGTERM)
            except SystemExit as ended:
                paths.close_once()
                code = 2 if happened else ended.code
            finally:
                os._exit(code)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 128 + signal.SIGTERM
    assert happened == ["closed"]


def test_signals_after_the_first_do_not_cut_its_way_out_short() -> None:
    happened: list[str] = []
    with (  # noqa: PT012
        pytest.raises(SystemExit) as exit_,
        ExitPaths(happened.append, lambda: happened.append("closed")),
    ):
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
                signal.raise_signal(number)
            happened.append("saved")
    assert exit_.value.code == 143
    assert happened[-2:] == ["saved", "closed"]


def test_a_signal_within_the_handler_of_another_waits() -> None:
    happened: list[str] = []

    def shut(why: str) -> None:
        happened.append(f"shuts for {why}")
        if len(happened) == 1:
            signal.raise_signal(signal.SIGINT)
        happened.append(f"shut for {why}")

    with pytest.raises(SystemExit) as exit_, ExitPaths(shut, lambda: None):
        signal.raise_signal(signal.SIGTERM)
    assert exit_.value.code in (143, 130)
    assert happened == ["shuts for SIGTERM", "shut for SIGTERM"]


def test_what_is_undisturbed_is_done_before_a_signal_ends_the_program_but_light_is_shut_at_once() -> None:
    happened: list[str] = []
    with (  # noqa: PT012
        pytest.raises(SystemExit),
        ExitPaths(happened.append, lambda: happened.append("closed")),
    ):
        with undisturbed():
            signal.raise_signal(signal.SIGTERM)
            happened.append("saved")
        pytest.fail("it goes on, in the dark")
    assert happened == ["SIGTERM", "saved", "closed"]


def test_a_bench_is_closed_once_whoever_closes_it() -> None:
    happened: list[str] = []
    with ExitPaths(happened.append, lambda: happened.append("closed")) as paths:
        close_benches()
        paths.close_once()
        assert happened == ["closed"]
    assert happened == ["closed"]


READING = """
import os, signal, sys, time
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.exit_paths import ExitPaths
lit = sys.argv[1] == "lit"
with ExitPaths(lambda why: print("shut by", why, flush=True), lambda: print("closed", flush=True), lambda: lit):
    print("open", flush=True)
    os.kill(os.getpid(), signal.SIGTTIN)
    print("goes on", flush=True)
"""


@pytest.mark.parametrize("light", ["lit", "dark"])
def test_who_reads_in_the_background_is_stopped_only_in_the_dark(light: str) -> None:
    child = subprocess.Popen([sys.executable, "-c", READING, light], stdout=subprocess.PIPE, text=True)
    stopped = False
    while True:
        found, status = os.waitpid(child.pid, os.WUNTRACED)
        if found and os.WIFSTOPPED(status):
            stopped = True
            os.kill(child.pid, signal.SIGCONT)
        elif found:
            break
    child.returncode = os.waitstatus_to_exitcode(status)
    assert child.stdout is not None
    said = child.stdout.read().split("\n")[:-1]
    child.stdout.close()
    if light == "lit":
        assert (stopped, child.returncode, said) == (False, 149, ["open", "shut by SIGTTIN", "closed"])
    else:
        assert (stopped, child.returncode, said) == (True, 0, ["open", "goes on", "closed"])
