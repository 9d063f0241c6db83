"""Two columns on a narrow terminal stay two columns, as a terminal of that width shows them; files get whole lines."""

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from nlos.acquisition.recording.recording import Status
from nlos.cli.runs import _HEADS, _show_narrow
from tests.nlos.test_status_page import growing


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


@pytest.mark.parametrize("columns", [40, 80])
def test_a_list_of_runs_that_is_too_wide_names_what_it_says(columns: int, tmp_path: Path) -> None:
    path = tmp_path / "a-night-of-scans" / f"{'long-' * 12}hut.h5"
    path.parent.mkdir()
    growing(path, 30).finish(Status.COMPLETE)
    lines = on_a_terminal(columns, "runs", "--folder", str(tmp_path))
    assert lines[0].split()[2:] == ["complete", "30/30"]
    assert "sample hut <i>, operator Ada" in lines[1]
    assert lines[2] == f"    {path.relative_to(tmp_path)}"  # to be copied whole
    assert lines[3].startswith("1 of 1 runs in ")


def test_a_list_of_runs_has_a_line_on_the_narrowest_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """Of less than five columns it was a bug of ours."""
    _show_narrow([_HEADS], 3)
    assert capsys.readouterr().out.splitlines()[-1] == "    path"
