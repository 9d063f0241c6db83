"""Ctrl-Z as a shell with job control sees it: light goes off first, then the program stops, and `fg` goes on."""

import shutil
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from nlos.cli import agreeing
from tests.acquisition.witnessed_bench import bench_file, witnessed
from tests.nlos.by_hand.at_a_terminal import AtATerminal, at_a_terminal
from tests.nlos.by_hand.witness import account
from tests.nlos.by_hand.witness import bench_file as bench_by_hand
from tests.nlos.test_every_signal import SCAN, TTL, shutter

pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="the shell whose job it is")
SHELL = ("bash", "--norc", "--noprofile", "-i")
PAUSED = "Enter resumes, Ctrl-C ends the scan."


@contextmanager
def shell(folder: Path) -> Iterator[AtATerminal]:
    """An interactive one, which is the terminal's."""
    with at_a_terminal(folder, program=SHELL) as found:
        yield found
        found.press("exit\r", "exit\r")  # the first is refused where a job is stopped


def test_ctrl_z_at_a_pause_stops_the_scan_and_fg_asks_again(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(SCAN)
    bench = bench_file(tmp_path, "S1, TTL shutter")
    with shell(tmp_path) as child:
        child.press(f"{sys.executable} -m nlos scan small.yaml --bench {bench} -o run.h5 || echo ended-by-$?\r")
        child.wait_until(lambda: "shutter open" in witnessed(tmp_path), "light")
        child.press("\x1a")
        child.wait_until(lambda: child.said.count(PAUSED) == 1, "the question")
        for times in (1, 2):
            child.press("\x1a")
            child.wait_until(lambda times=times: child.said.count("Stopped") == times, "a stopped job")
            assert shutter(tmp_path)[-1] == "shutter closed"
            child.press("fg\r")
            child.wait_until(lambda times=times: child.said.count(PAUSED) == 1 + times, "the question again")
        lit = shutter(tmp_path).count("shutter open")
        child.press("\r")
        child.wait_until(lambda: shutter(tmp_path).count("shutter open") > lit, "light again")
        child.press("\x03")
        child.wait_until(lambda: child.said.count(PAUSED) == 4, "the question after Ctrl-C")
        child.press("\x03")
        child.wait_for("run.h5; `--resume` takes the others.")
    assert shutter(tmp_path)[-1] == "shutter closed"


@pytest.mark.parametrize("words", ["point 0.1 0.0 --hold 60", "monitor", "jog"])
def test_ctrl_z_shuts_light_by_hand_before_it_stops_and_fg_goes_on_in_the_dark(tmp_path: Path, words: str) -> None:
    """`jog` and `monitor` leave the terminal's second screen meanwhile, and draw on it again; keys are keys again."""
    bench = bench_by_hand(tmp_path, TTL)
    with shell(tmp_path) as child:
        child.press(f"{sys.executable} -m nlos {words} --light 20 --bench {bench}\r")
        child.wait_until(lambda: account(tmp_path).lit, "light")
        child.press("\x1a")
        child.wait_for("Stopped")
        assert account(tmp_path).ends_dark
        child.press("echo $((6 * 7)) words\r")  # the terminal is the shell's, and echoes
        child.wait_for("42 words")
        screens = len(child.frames)
        child.press("fg; echo went-$?\r")
        if not words.startswith("point"):
            child.wait_until(lambda: len(child.frames) > screens + 2, "the screen again")
        until_s = time.monotonic() + 60
        while "went-0" not in child.said and time.monotonic() < until_s:
            child.press("q")  # what comes while the terminal changes hands is dropped
            time.sleep(0.1)
        child.press("\x15")  # the shell's, where one came too many
        assert "went-0" in child.said
    assert len(account(tmp_path).lit) == 1
    assert account(tmp_path).ends_dark
    assert account(tmp_path).lit_s < 10


CONFIRM = {"arm": {"confirm": True, "remote": True}}
AGREE = 'Type "light" to agree, Enter to stop here.'


@pytest.mark.parametrize("words", ["scan small.yaml -o run.h5", "point 0.1 0.0 --light 0.5"])
def test_ctrl_z_at_the_question_before_light_stops_the_program_and_fg_asks_again(tmp_path: Path, words: str) -> None:
    (tmp_path / "small.yaml").write_text(SCAN.replace("128", "2"))
    bench = bench_by_hand(tmp_path, {**TTL, **CONFIRM})
    with shell(tmp_path) as child:
        child.press(f"{sys.executable} -m nlos {words} --bench {bench}; echo went-$?\r")
        child.wait_until(lambda: child.said.count(AGREE) == 1, "the question")
        child.press("\x1a")
        child.wait_for("Stopped")
        child.press("fg; echo went-$?\r")
        child.wait_until(lambda: child.said.count(AGREE) == 2, "the question again")
        assert not account(tmp_path).lit
        child.press("light\r")
        child.wait_for("went-0")
    assert account(tmp_path).lit
    assert account(tmp_path).ends_dark


def test_ctrl_z_in_the_warning_time_stops_light_by_hand_which_is_announced_anew(tmp_path: Path) -> None:
    bench = bench_by_hand(tmp_path, {**TTL, "arm": {"delay_s": 3.0, "remote": True}})
    with shell(tmp_path) as child:
        child.press(f"{sys.executable} -m nlos point 0.1 0.0 --light 0.5 --bench {bench}; echo went-$?\r")
        child.wait_until(lambda: child.said.count("light in 3 s") == 1, "the warning")
        child.press("\x1a")
        child.wait_for("Stopped")
        time.sleep(1.2)  # what is stopped for less goes on counting
        assert not account(tmp_path).lit
        child.press("fg; echo then-$?\r")
        child.wait_until(lambda: child.said.count("light in 3 s") == 2, "the warning again")
        child.wait_for("then-0")
    assert len(account(tmp_path).lit) == 1


def test_ctrl_z_at_a_question_is_left_to_the_bench_where_light_may_be_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(agreeing, "STOP", signal.SIGCONT)  # does nothing to who runs
    lit, said, before = False, [], []
    monkeypatch.setattr(agreeing, "light_may_be_on", lambda: lit)
    was = signal.signal(signal.SIGTSTP, lambda number, frame: before.append(number))
    try:
        with agreeing.asked_again(lambda: said.append("again")):
            signal.raise_signal(signal.SIGTSTP)
            assert (said, before) == (["again"], [])
            lit = True
            signal.raise_signal(signal.SIGTSTP)
        signal.raise_signal(signal.SIGTSTP)
    finally:
        signal.signal(signal.SIGTSTP, was)
    assert (said, before) == (["again"], [signal.SIGTSTP] * 2)
