"""Whatever takes its time says how far it is: a bar with rate and time left on a terminal, lines elsewhere."""

import contextlib
import logging
import os
import pty
import re
import subprocess
import sys
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.recording import writer_lock
from nlos.cli.progress import Progress, Stages
from nlos.cli.terminal import terminal

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]


def test_a_line_says_rate_and_time_left(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(terminal, "verbosity", 0)
    with Progress(10, what="import", unit="files", line_s=-1.0) as progress:
        progress.step(4)
    assert re.search(r"^4 of 10 files, [\d.]+ files/(s|min), \d+ s left$", capsys.readouterr().err, re.M)


def test_a_stage_that_begins_late_is_no_pace(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As where a network share takes its time before a file is read: nothing is done yet."""
    monkeypatch.setattr(terminal, "verbosity", 0)
    with Progress(4, what="reconstruct", unit="stages", line_s=-1.0) as progress:
        progress.step(0)
    assert capsys.readouterr().err.startswith("0 of 4 stages")


def test_a_terminal_that_only_shows_text_gets_lines(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An editor's shell: a bar would be seen at the end alone."""
    monkeypatch.setattr(terminal, "verbosity", 0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "dumb")
    with Progress(10, what="import", unit="files", line_s=-1.0) as progress:
        progress.step(4)
    assert capsys.readouterr().err.startswith("4 of 10 files, ")


def test_a_bar_shows_a_files_name_as_it_is_and_obeys_it_in_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bar writes past the stream that escapes what is printed."""
    screen = StringIO()
    monkeypatch.setattr(screen, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "180")
    name = "a[b]c [bold]\x1b]0;owned\x07\u202e.npz"
    with Progress(2, what=f"import {name}") as progress:
        progress.at(f"reading {name}")
    with Stages(name, "nlos.calibration"):
        logging.getLogger("nlos.calibration").debug("fitting %s", name)
    shown = screen.getvalue()
    told = "a[b]c [bold]\\x1b]0;owned\\x07\\u202e.npz"
    assert all(words in shown for words in (f"import {told}", f"reading {told}", f"fitting {told}"))
    assert not {"\x07", "\u202e", "\x1b]"} & {shown[at : at + size] for at in range(len(shown)) for size in (1, 2)}


@pytest.mark.parametrize("columns", [40, 60, 80, 200])
def test_on_a_narrow_terminal_and_beside_a_long_name_it_says_how_many_and_how_long(
    monkeypatch: pytest.MonkeyPatch, columns: int
) -> None:
    screen = StringIO()
    monkeypatch.setattr(screen, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", str(columns))
    with Progress(65536, what="import a-name-of-many-words-that-somebody-gave-to-a-file.mat") as progress:
        progress.step(16384, ", 2 to be taken again")
        progress.at("reading")
    lines = [re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", line).strip() for line in re.split("[\r\n]", screen.getvalue())]
    assert any(re.search(r"^import.* 16384/65536 .*(-:--:--|\d:\d\d:\d\d)$", each) for each in lines)
    assert max(len(each) for each in lines) <= columns


def test_a_terminal_of_few_letters_is_sent_no_other(tmp_path: Path) -> None:
    """What it lacks would be written out, six letters for one: lines that are too long stay where they were."""
    script = tmp_path / "wait.py"
    script.write_text(
        "from nlos.cli.progress import Progress, Stages\n"
        f"with Stages('{'calibrate ' * 20}', 'nlos'): pass\n"
        f"with Progress(9, what='{'import ' * 30}') as progress: progress.at('reading')\n"
    )
    ours, theirs = pty.openpty()
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "TERM": "xterm", "COLUMNS": "80"}
    subprocess.run([sys.executable, str(script)], stderr=theirs, env={**os.environ, **plain}, check=True, timeout=240)
    os.close(theirs)
    shown = b""
    with contextlib.suppress(OSError):  # nobody writes there any more
        while part := os.read(ours, 65536):
            shown += part
    os.close(ours)
    assert b"calibrate" in shown
    assert b"import" in shown
    assert b"\\u" not in shown


def test_a_pause_is_none_of_the_pace(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    now_s = [100.0]
    monkeypatch.setattr(terminal, "verbosity", 0)
    monkeypatch.setattr("nlos.cli.progress.time.monotonic", lambda: now_s[0])
    progress = Progress(100, what="scan", line_s=0.0)
    now_s[0] += 50.0  # before the first step is waited for
    progress.show()
    now_s[0] += 1.0
    progress.step(20)
    progress.hide()
    now_s[0] += 3600.0
    progress.show()
    now_s[0] += 1.0
    progress.step(20)
    shown = capsys.readouterr().err.splitlines()
    assert shown == ["20 of 100 points, 20 points/s, 4 s left", "40 of 100 points, 20 points/s, 3 s left"]


def test_who_knows_better_than_that_all_points_are_alike_is_believed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now_s = [100.0]
    monkeypatch.setattr(terminal, "verbosity", 0)
    monkeypatch.setattr("nlos.cli.progress.time.monotonic", lambda: now_s[0])
    progress = Progress(100, what="scan", line_s=0.0)
    now_s[0] += 2.0
    progress.step(50, times_as_long=10.0)
    assert capsys.readouterr().err == "50 of 100 points, 25 points/s, 20 s left\n"


def test_a_stage_of_unknown_length_says_how_long_it_takes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(terminal, "verbosity", 0)
    logger = logging.getLogger("nlos.calibration.spots_fit")
    with Stages("calibrate", "nlos.calibration", line_s=-1.0):
        logger.debug("fitting spots alone")
    logger.debug("nobody listens any more")
    assert capsys.readouterr().err == "calibrate: fitting spots alone, 0 s so far\n"


def on_a_terminal(folder: Path, *words: str) -> str:
    """What a command writes to a terminal's screen."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "nlos", *words], cwd=folder, stdin=theirs, stdout=theirs, stderr=theirs,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "140"},
    )  # fmt: skip
    os.close(theirs)
    seen = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:
            break
        if not part:
            break
        seen += part
    os.close(ours)
    assert process.wait(240) == 0, seen
    return seen.decode(errors="replace")


def test_the_verbs_that_take_long_show_a_bar(nlos: Nlos, small: Path, tmp_path: Path) -> None:
    assert nlos("scan", small.name, "-o", "run.h5").returncode == 0
    assert nlos("export", "run.h5", "--to", "npz", "-o", "run.npz").returncode == 0
    shown = on_a_terminal(tmp_path, "reconstruct", "run.h5", "-o", "out")
    assert "reconstruct: lct on 4 x 4" in shown
    assert "reconstruct: drawing" in shown
    assert "import run.npz" in on_a_terminal(tmp_path, "import", "run.npz", "-o", "again.h5")
    assert not list(tmp_path.glob(".*.part*"))


def test_an_import_that_breaks_off_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nlos.acquisition.importers.isolated import read_isolated
    from nlos.acquisition.importers.to_recording import write_recording

    histograms = np.random.default_rng(0).poisson(3.0, (8, 8, 32)).astype(np.uint32)
    np.savez(tmp_path / "a.npz", histograms=histograms, bin_width_s=32e-12, wall_size_m=1.0)
    scan = read_isolated(tmp_path / "a.npz")
    (tmp_path / "run.h5").write_bytes(b"another file")

    def interrupted(*asked: object, **more: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as begun:
        begun.setattr(writer_lock, "_lock", interrupted)  # its file is there, and nobody holds it yet
        with pytest.raises(KeyboardInterrupt):
            write_recording(scan, tmp_path / "a.npz", tmp_path / "run.h5", overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "run.h5"]
    with pytest.raises(KeyboardInterrupt):
        write_recording(scan, tmp_path / "a.npz", tmp_path / "run.h5", overwrite=True, step=interrupted)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "run.h5"]
    assert (tmp_path / "run.h5").read_bytes() == b"another file"
    assert write_recording(scan, tmp_path / "a.npz", tmp_path / "run.h5", overwrite=True) == 64
