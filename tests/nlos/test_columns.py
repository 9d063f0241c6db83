"""Two columns on a narrow terminal stay two columns, as a terminal of that width shows them; files get whole lines."""

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios

import pytest


def on_a_terminal(columns: int, *words: str) -> list[str]:
    """The lines that `nlos WORDS` leaves on a terminal so wide."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 60, columns, 0, 0))
    narrow = {key: value for key, value in os.environ.items() if key not in ("COLUMNS", "LINES")}
    command = [sys.executable, "-m", "nlos", *words]
    with subprocess.Popen(command, stdout=theirs, stderr=theirs, stdin=subprocess.DEVNULL, env=narrow) as running:
        os.close(theirs)
        said = b""
        try:
            while more := os.read(ours, 65536):
                said += more
        except OSError:  # Linux's word for the end
            pass
        assert running.wait(timeout=300) == 0
    os.close(ours)
    return said.decode().replace("\r", "").splitlines()


@pytest.mark.parametrize("columns", [80, 120])
def test_no_word_of_a_catalogue_is_broken_by_a_terminals_edge(columns: int) -> None:
    lines = on_a_terminal(columns, "patterns")
    whole = subprocess.run(
        [sys.executable, "-m", "nlos", "patterns"], capture_output=True, text=True, check=True, timeout=300
    ).stdout
    table = lines[: lines.index("")]
    assert max(map(len, table)) <= columns
    assert any(line.startswith(" " * 20) for line in table)  # what did not fit stands under its column
    assert " ".join(" ".join(lines).split()) == " ".join(whole.split())  # the same words, none in two
    assert max(map(len, whole.splitlines())) > 80  # and whole lines off a terminal
