"""Keys of a terminal: as it was once they are no longer read, gone with it, and held for light."""

import io
import os
import pty
import select
import signal
import sys
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from nlos.acquisition.planning.preflight import drawn_aim
from nlos.by_hand.hand import FIRST_HOLD_S, HOLD_S, Hand
from nlos.by_hand.keys import Keys, keys_of_terminal
from nlos.by_hand.stops import Stops
from nlos.configs.load import load
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.partial_bench import open_partial_bench
from tests.nlos.by_hand.witness import bench_file


@contextmanager
def a_terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The far end of one that is standard input and output while the block runs."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "rb", buffering=0) as terminal:
        text = io.TextIOWrapper(terminal)
        monkeypatch.setattr("sys.stdin", text)
        monkeypatch.setattr("sys.stdout", text)
        yield ours


def test_a_terminal_that_is_closed_ends_in_no_error_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    with a_terminal(monkeypatch) as ours, keys_of_terminal(Stops()) as keys:
        assert keys.there
        os.write(ours, b"a")
        assert keys.pressed() == ["a"]
        os.close(ours)
        assert keys.pressed() == ["q"]


def test_a_terminal_is_as_it_was_once_its_keys_are_no_longer_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor is a program stopped meanwhile because it reads in the background: it could not shut the light."""
    with a_terminal(monkeypatch) as ours:
        before, stopped_by = termios.tcgetattr(ours), signal.getsignal(signal.SIGTTIN)
        os.write(ours, b" \n")  # pressed before anybody looked: no wish for light
        assert select.select([sys.stdin], [], [], 60.0)[0], "the terminal did not hand it on"
        with keys_of_terminal(Stops()) as keys:
            assert not termios.tcgetattr(ours)[3] & (termios.ICANON | termios.ECHO)
            assert signal.getsignal(signal.SIGTTIN) is signal.SIG_IGN
            assert keys.pressed() == []
        assert termios.tcgetattr(ours) == before
        assert signal.getsignal(signal.SIGTTIN) is stopped_by


def test_a_key_that_is_held_gives_light_for_little_longer_than_it_is(tmp_path: Path) -> None:
    """Its first press lasts until a keyboard repeats it; from then on each lasts until the next one."""
    keyboard, fingers = os.pipe()
    settings = load("bench", str(bench_file(tmp_path)), BenchSettings).settings
    with open_partial_bench(settings, {"mirror"}) as bench:
        hand = Hand(bench, drawn_aim(settings.geometry), Keys(keyboard), Stops())

        def left_after_a_press_s() -> float:
            os.write(fingers, b" ")
            assert hand.pressed() == []
            return hand.light.left_s

        assert HOLD_S < left_after_a_press_s() <= FIRST_HOLD_S
        hand.light.end("nobody holds it")
        bench.clock.sleep(FIRST_HOLD_S)
        since_s, left_s = FIRST_HOLD_S, 0.0
        while since_s >= FIRST_HOLD_S:  # on a busy computer the second press may come as late as a first one
            left_after_a_press_s()
            pressed_s = bench.clock.now()
            bench.clock.sleep(0.7 * FIRST_HOLD_S)
            left_s = left_after_a_press_s()
            since_s = bench.clock.now() - pressed_s
        assert 0 < left_s <= HOLD_S
        hand.light.end("nobody holds it")
    os.close(keyboard)
    os.close(fingers)
