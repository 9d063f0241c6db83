"""A terminal that takes nothing more (Ctrl-S, a connection that hangs) holds up nothing while light is on, nor the end
of a recording, nor of a command that is told to end."""

import contextlib
import os
import pty
import signal
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording.recording import Recording, Status
from nlos.cli.interrupts import end_at_interrupts, end_in_order_at_sigterm, never_lose_an_interrupt
from nlos.cli.outliving import OutlivingStream
from nlos.drivers.exit_paths import ExitPaths, signal_soon, tell_to_end
from tests.acquisition.killed_scans import FORK
from tests.acquisition.witnessed_bench import bench_file, is_parked, witnessed
from tests.nlos.by_hand.at_a_terminal import at_a_terminal

SCAN = """\
wall: {width_m: 0.6, height_m: 0.6, rows: 128, cols: 128}
pattern: serpentine
dwell_ms: 20
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 8}
"""


def socket_pair() -> list[int]:
    """As the system's log and some ssh servers give a program for its output."""
    return [each.detach() for each in socket.socketpair()]


@pytest.mark.parametrize("opened", [pty.openpty, os.pipe, socket_pair])
def test_what_nobody_takes_is_dropped_in_the_light_and_what_somebody_takes_is_whole(opened: object) -> None:
    ours, theirs = opened()  # type: ignore[operator]
    whole = "".join(f"line {number}\n" for number in range(100))

    def write() -> None:
        stream = OutlivingStream(os.fdopen(theirs, "w"))
        with ExitPaths(lambda why: None, lambda: None, lambda: True):
            stream.write(whole)
            stream.flush()
            for _ in range(3000):  # more than any of them holds
                stream.write("x" * 99 + "\n")
                stream.flush()
        os._exit(0)

    assert _ends(write, within_s=240) == 0
    assert os.read(ours, 512).decode().replace("\r", "").startswith(whole[:300])
    os.close(ours)
    os.close(theirs)


@pytest.mark.parametrize("hurried", ["by light", "by a signal"])
def test_what_waits_in_the_dark_waits_no_longer_once_nothing_may(hurried: str) -> None:
    """A thread of the screen, say, with the lock that everybody needs who has something to show."""
    ours, theirs = pty.openpty()

    def write() -> None:
        stream, lit = OutlivingStream(os.fdopen(theirs, "w")), threading.Event()
        with ExitPaths(lambda why: None, lambda: None, lit.is_set):
            thread = threading.Thread(target=stream.write, args=("x" * 300_000,))  # more than any of them holds
            thread.start()
            thread.join(0.5)
            if not thread.is_alive():
                os._exit(1)  # in the dark all of it is waited for
            if hurried == "by light":
                lit.set()
            else:
                tell_to_end()
            thread.join()
        os._exit(0)

    assert _ends(write) == 0
    os.close(ours)
    os.close(theirs)


def test_what_was_written_before_the_first_bench_is_not_waited_for_once_the_command_is_told_to_end() -> None:
    ours, theirs = pty.openpty()

    def write() -> None:
        stream = OutlivingStream(os.fdopen(theirs, "w"))
        stream.write("x" * 1000)  # no whole line: it is kept below
        os.set_blocking(theirs, False)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(theirs, b"x" * 512)
        os.set_blocking(theirs, True)
        tell_to_end()
        stream.flush()
        os._exit(0)

    assert _ends(write) == 0
    os.close(ours)
    os.close(theirs)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_what_is_shown_on_the_way_out_of_a_command_that_a_signal_ended_waits_for_no_terminal(number: int) -> None:
    """A bar that is taken off the screen as the exception passes, long before anybody says that the command ends."""
    ours, theirs = pty.openpty()

    def write() -> None:
        never_lose_an_interrupt()
        end_at_interrupts()
        end_in_order_at_sigterm()
        stream = OutlivingStream(os.fdopen(theirs, "w"))
        with ExitPaths(lambda why: None, lambda: None):
            stream.write("from now on in pieces\n")
        signal_soon(number, 0.5)
        try:
            stream.write("x" * 300_000)  # more than it holds
        except (KeyboardInterrupt, SystemExit):
            stream.write("x" * 1000)
            os._exit(0)

    assert _ends(write) == 0
    os.close(ours)
    os.close(theirs)


def _ends(what: Callable[[], None], within_s: float = 60) -> int | None:
    child = FORK.Process(target=what)
    child.start()
    child.join(within_s)
    ended = child.exitcode
    child.kill()
    child.join()
    return ended


def _status(run: Path) -> Status | None:
    try:
        with Recording.open(run) as recording:
            return recording.status
    except (InvalidData, OSError):  # between two writes
        return None


def test_a_scan_before_a_stopped_terminal_ends_its_recording_and_ends_when_told(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(SCAN.replace("128", "24"))
    path = bench_file(tmp_path, "S2")
    with at_a_terminal(tmp_path, "scan", "small.yaml", "--bench", str(path), "-o", "run.h5") as child:
        child.wait_until(lambda: "shutter open" in witnessed(tmp_path), "light")
        child.press("\x13")  # Ctrl-S
        child.wait_until(lambda: _status(tmp_path / "run.h5") is Status.COMPLETE, "the end of the recording", 120)
        child.wait_until(lambda: not (tmp_path / "run.h5.lock").exists(), "nobody who writes it")
        child.wait_until(lambda: is_parked(witnessed(tmp_path)[-1]), "a bench that is closed")
        assert child.process.poll() is None  # held by the terminal, which has not shown all of it
        child.signal(signal.SIGTERM)
        assert child.ends() == 143


@pytest.mark.parametrize("after_s", [0.0, 0.05])
def test_a_command_to_end_while_the_bench_is_closed_before_a_stopped_terminal_is_obeyed(
    tmp_path: Path, after_s: float
) -> None:
    (tmp_path / "small.yaml").write_text(SCAN.replace("128", "12"))
    path = bench_file(tmp_path, "S2")
    with at_a_terminal(tmp_path, "scan", "small.yaml", "--bench", str(path), "-o", "run.h5", "-v") as child:
        child.wait_until(lambda: "shutter open" in witnessed(tmp_path), "light")
        child.press("\x13")  # Ctrl-S
        child.wait_until(lambda: _status(tmp_path / "run.h5") is Status.COMPLETE, "the end of the recording", 120)
        time.sleep(after_s)
        child.signal(signal.SIGTERM)
        assert child.ends() == 143
        assert witnessed(tmp_path)[-1] != "shutter open"


def test_a_scan_that_has_something_to_say_to_a_stopped_terminal_shuts_its_light(tmp_path: Path) -> None:
    """A counter that answers nothing three times is an error of the scan, told with -v from the first time on."""
    (tmp_path / "small.yaml").write_text(SCAN)
    path = bench_file(tmp_path, "S1, TTL shutter")
    faults = "simulation:\n  faults: [{name: U1, after_s: 20.0, times: 3}]\n"
    path.write_text(path.read_text().replace("simulation:\n", faults))
    with at_a_terminal(tmp_path, "scan", "small.yaml", "-v", "--bench", str(path), "-o", "run.h5") as child:
        child.wait_until(lambda: "shutter open" in witnessed(tmp_path), "light")
        child.press("\x13")  # Ctrl-S
        child.wait_until(lambda: witnessed(tmp_path)[-1] == "shutter closed", "dark", 60)
        child.press("\x11")  # Ctrl-Q
        assert child.ends() == 9
