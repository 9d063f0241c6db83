"""Keys of a terminal that goes away."""

import io
import os
import pty

import pytest

from nlos.by_hand.keys import keys_of_terminal
from nlos.by_hand.stops import Stops


def test_a_terminal_that_is_closed_ends_in_no_error_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "rb", buffering=0) as terminal:
        text = io.TextIOWrapper(terminal)
        monkeypatch.setattr("sys.stdin", text)
        monkeypatch.setattr("sys.stdout", text)
        with keys_of_terminal(Stops()) as keys:
            assert keys.there
            os.write(ours, b"a")
            assert keys.pressed() == ["a"]
            os.close(ours)
            assert keys.pressed() == ["q"]
