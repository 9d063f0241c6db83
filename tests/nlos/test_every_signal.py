"""Every signal that a program can catch and that would end or stop it: the light goes off, by the table's own account.

What cannot be caught, or is Python's own crash, is left to the instrument's watchdog and the interlock.
"""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from nlos.acquisition.recording.recording import Recording, Status
from tests.acquisition.witnessed_bench import bench_file, witnessed
from tests.nlos.by_hand.at_a_terminal import at_a_terminal
from tests.nlos.by_hand.witness import account
from tests.nlos.by_hand.witness import bench_file as bench_by_hand

SOAK = os.environ.get("NLOS_SOAK") == "1"
CRASHES = {"SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL", "SIGEMT"}
NOT_CAUGHT = {"SIGKILL", "SIGSTOP"}
IGNORED = {"SIGCHLD", "SIGCLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGINFO", "SIGPIPE", "SIGXFSZ"}
"""By the system, or by Python."""
ALL = sorted(number.name for number in signal.Signals if number.name not in CRASHES | NOT_CAUGHT | IGNORED)
SCAN = """\
wall: {width_m: 0.6, height_m: 0.6, rows: 128, cols: 128}
pattern: serpentine
dwell_ms: 20
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 8}
"""
TTL = {"shutter": {"model": "triggerscope_ttl"}, "mirror": {"shutter_pin": 16}}


def shutter(folder: Path) -> list[str]:
    """What the table says of it."""
    return [line for line in witnessed(folder) if line.startswith("shutter")]


def lit_scan(folder: Path) -> "subprocess.Popen[str]":
    """A scan with a shutter that no watchdog closes, in a process group of its own that a shell could stop."""
    (folder / "small.yaml").write_text(SCAN)
    command = [sys.executable, "-m", "nlos", "scan", "small.yaml", "-o", "run.h5"]
    child = subprocess.Popen(
        [*command, "--bench", str(bench_file(folder, "S1, TTL shutter"))], cwd=folder, stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, process_group=0,
    )  # fmt: skip
    until_s = time.monotonic() + 240
    while "shutter open" not in witnessed(folder) and child.poll() is None and time.monotonic() < until_s:
        time.sleep(0.01)
    return child


def ended(child: "subprocess.Popen[str]") -> int:
    """Its exit code; one that is stopped is no end."""
    until_s = time.monotonic() + 240
    while time.monotonic() < until_s:
        found, status = os.waitpid(child.pid, os.WNOHANG | os.WUNTRACED)
        if found:
            assert not os.WIFSTOPPED(status), "it was stopped"
            child.returncode = os.waitstatus_to_exitcode(status)
            return child.returncode
        time.sleep(0.02)
    raise AssertionError("it did not end")


@pytest.mark.sampled(2)
@pytest.mark.soak
@pytest.mark.parametrize("name", ALL if SOAK else ["SIGTERM", "SIGQUIT", "SIGTSTP", "SIGABRT", "SIGTTIN", "SIGRTMAX"])
def test_a_signal_that_would_end_or_stop_a_scan_shuts_its_light(tmp_path: Path, name: str) -> None:
    child = lit_scan(tmp_path)
    try:
        child.send_signal(signal.Signals[name])
        if name == "SIGTTOU":  # of who prints in the background: it goes on printing
            time.sleep(1.0)
            child.send_signal(signal.SIGTERM)
        code = ended(child)
    finally:
        if child.returncode is None:
            child.send_signal(signal.SIGCONT)
            child.kill()
            child.wait()
        assert child.stderr is not None
        said = child.stderr.read()
        child.stderr.close()
    assert code == {"SIGINT": 130, "SIGTSTP": 130, "SIGTTOU": 143}.get(name, 128 + signal.Signals[name]), said
    assert "Traceback" not in said
    assert shutter(tmp_path)[-1] == "shutter closed"
    with Recording.open(tmp_path / "run.h5") as recording:
        assert recording.status is Status.INTERRUPTED


def test_ctrl_z_pauses_a_scan_in_the_dark_and_ctrl_c_ends_it(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(SCAN)
    path = bench_file(tmp_path, "S1, TTL shutter")
    with at_a_terminal(tmp_path, "scan", "small.yaml", "--bench", str(path), "-o", "run.h5") as child:
        child.wait_until(lambda: "shutter open" in witnessed(tmp_path), "light")
        child.press("\x1a")
        child.wait_for("paused by Ctrl-Z in the terminal; the shutter is closed")
        assert shutter(tmp_path)[-1] == "shutter closed"
        child.press("\r")
        child.wait_until(
            lambda: [x for x in witnessed(tmp_path) if x.startswith("shutter")][-1] == "shutter open", "light"
        )
        child.press("\x1c")  # Ctrl-\\
        assert child.ends() == 131
    assert shutter(tmp_path)[-1] == "shutter closed"


def test_ctrl_z_at_a_beam_whose_words_go_into_a_file_stops_it_in_the_dark(tmp_path: Path) -> None:
    """Without a terminal, too; with one: `test_stopped_jobs.py`."""
    path = bench_by_hand(tmp_path, TTL)
    child = subprocess.Popen(
        [sys.executable, "-m", "nlos", "point", "0.1", "0.0", "--light", "5", "--bench", str(path)], cwd=tmp_path,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True, process_group=0,
    )  # fmt: skip
    until_s = time.monotonic() + 240
    while not account(tmp_path).lit and child.poll() is None and time.monotonic() < until_s:
        time.sleep(0.01)
    try:
        child.send_signal(signal.SIGTSTP)
        _, status = os.waitpid(child.pid, os.WUNTRACED)
        assert os.WIFSTOPPED(status)
        assert account(tmp_path).ends_dark
        child.send_signal(signal.SIGTERM)
        child.send_signal(signal.SIGCONT)
        assert ended(child) == 143
    finally:
        if child.returncode is None:
            child.send_signal(signal.SIGCONT)
            child.kill()
            child.wait()
    assert account(tmp_path).lit
    assert account(tmp_path).ends_dark


def test_a_wire_log_that_outgrows_its_disk_ends_and_the_light_goes_off_in_its_time(tmp_path: Path) -> None:
    path = bench_by_hand(tmp_path, TTL)
    done = subprocess.run(
        [sys.executable, "-m", "nlos", "monitor", "--light", "1", "--for", "2", "--bench", str(path),
         "--wire-log", "wire.log"],
        cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        timeout=240, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, resource.RLIM_INFINITY)),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "wire.log: not every byte" in done.stderr
    assert (tmp_path / "wire.log").stat().st_size == 40_000
    assert account(tmp_path).lit
    assert account(tmp_path).ends_dark
