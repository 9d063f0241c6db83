"""A scan that is paused by Ctrl-C on a terminal has all its samples in the file while it waits for somebody."""

import io
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.scanning.control import ScanControl
from nlos.cli.interrupts import Interrupts
from nlos.configs.load import find

SCAN = """\
wall: {width_m: 0.6, height_m: 0.6, rows: 32, cols: 32}
pattern: serpentine
dwell_ms: 20
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 8}
"""


def acknowledged(path: Path) -> int:
    with Recording.open(path) as recording:
        return recording.acknowledged


def test_nothing_is_at_stake_while_a_scan_is_paused(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(SCAN)
    witness, run = tmp_path / "witness.txt", tmp_path / "run.h5"
    bench = find("bench", "simulated").read_text()
    (tmp_path / "bench.yaml").write_text(bench.replace("simulation:\n", f"simulation:\n  witness: {witness}\n"))
    terminal, other_end = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-m", "nlos", "scan", "small.yaml", "--bench", "bench.yaml", "-o", "run.h5"],
        cwd=tmp_path, stdin=other_end, stderr=other_end, stdout=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    os.close(other_end)
    try:
        said, until_s = b"", time.monotonic() + 240
        while not (witness.exists() and witness.read_text().count("beam to") > 100) and time.monotonic() < until_s:
            time.sleep(0.01)
        os.write(terminal, b"\n\n")  # as somebody does who looks on: no answer to what is asked later
        child.send_signal(signal.SIGINT)
        while b"paused" not in said:
            said += os.read(terminal, 4096)
        lit = witness.read_text().count("shutter open")
        paused_at = acknowledged(run)
        time.sleep(0.5)  # it asks only after it has said so
        assert witness.read_text().count("shutter open") == lit, "light for an Enter of before the pause"
        os.write(terminal, b"go \xff\n")
        while b"Enter alone resumes" not in said:
            said += os.read(terminal, 4096)
        assert witness.read_text().count("shutter open") == lit, "light for a word that is not Enter"
        child.send_signal(signal.SIGINT)
        assert child.wait(240) == 130
    finally:
        child.kill()
        child.wait()
        os.close(terminal)
    assert 0 < paused_at == acknowledged(run) < 1024


@pytest.mark.parametrize(("at_a_terminal", "why"), [(True, "Ctrl-C in the terminal"), (False, "SIGINT")])
def test_a_recording_names_no_terminal_where_there_was_none(
    monkeypatch: pytest.MonkeyPatch, at_a_terminal: bool, why: str
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    monkeypatch.setattr("sys.stdin.isatty", lambda: at_a_terminal)
    control = ScanControl()
    with Interrupts().caught() as interrupts:
        interrupts.pauses(control, shuttered=True)
        signal.raise_signal(signal.SIGINT)
        assert (control.wanted, interrupts.seen) == (why, True)
        with pytest.raises(KeyboardInterrupt):  # a second one does not wait for the pause
            signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize(("reads", "shows"), [(True, False), (False, True), (False, False)])
def test_nobody_is_asked_where_the_question_cannot_be_read_or_answered(
    monkeypatch: pytest.MonkeyPatch, reads: bool, shows: bool
) -> None:
    """`nlos scan ... 2> log` at a terminal, say: Ctrl-C ends the scan there, rather than wait for an unseen Enter."""
    monkeypatch.setattr("sys.stdin", io.StringIO("\n"))
    monkeypatch.setattr("sys.stdin.isatty", lambda: reads)
    monkeypatch.setattr("sys.stderr", io.StringIO())
    monkeypatch.setattr("sys.stderr.isatty", lambda: shows)
    assert not Interrupts().ask("SIGINT")
    assert sys.stdin.read() == "\n"


class Fingers(io.StringIO):
    """A terminal at which Ctrl-C is pressed before Enter."""

    def isatty(self) -> bool:
        return True

    def readline(self, size: int = -1, /) -> str:
        signal.raise_signal(signal.SIGINT)
        return "\n"


@contextmanager
def a_scan_that_pauses(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Interrupts, ScanControl, Fingers]]:
    """At such a terminal: who asks there, what Ctrl-C pauses, and what was said."""
    monkeypatch.setattr("sys.stdin", Fingers())
    monkeypatch.setattr("sys.stderr", said := Fingers())
    control = ScanControl()
    with Interrupts().caught() as interrupts:
        interrupts.pauses(control, shuttered=True)
        yield interrupts, control, said


@pytest.mark.parametrize(
    ("why", "how"),
    [("alarm: the rate", "(alarm: the rate)"), ("Ctrl-C in the terminal", "by Ctrl-C in the terminal")],
)
def test_the_first_ctrl_c_at_the_question_ends_the_scan_whatever_paused_it(
    monkeypatch: pytest.MonkeyPatch, why: str, how: str
) -> None:
    with a_scan_that_pauses(monkeypatch) as (interrupts, control, said):
        assert not interrupts.ask(why)
        assert not control.wanted
    assert said.getvalue() == f"paused {how}; the shutter is closed. Enter resumes, Ctrl-C ends the scan.\n"


@pytest.mark.parametrize(("why", "asked"), [("Ctrl-C in the terminal", False), ("alarm: the rate", True)])
def test_nobody_is_asked_whether_a_scan_resumes_that_has_its_last_point(
    monkeypatch: pytest.MonkeyPatch, why: str, asked: bool
) -> None:
    with a_scan_that_pauses(monkeypatch) as (interrupts, _, said):
        assert interrupts.ask(why, over=True) is not asked
        assert not interrupts.seen or asked
    assert ("Enter resumes" in said.getvalue()) is asked
