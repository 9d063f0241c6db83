"""The wire log of commands that open their bench more than once, and what is no name for it."""

import json
import re
from pathlib import Path

import pytest

from tests.nlos.conftest import Nlos

OPENED = re.compile(r"tcspc488.* > .*\*IDN\?")


def test_a_sweep_logs_every_opening_into_one_file_and_says_so_once(nlos: Nlos, small: Path, tmp_path: Path) -> None:
    done = nlos("scan", str(small), "--sweep", "dwell_ms=1,2", "-o", "swept", "--wire-log", "wire.log")
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "swept").glob("*.h5"))) == 2
    text = (tmp_path / "wire.log").read_text()
    assert len(OPENED.findall(text)) > 2
    assert text.count("OUTP:SHUT OPEN") >= 2
    assert done.stderr.count("wire.log: every byte") == 1
    again = nlos("scan", str(small), "-o", "run.h5", "--wire-log", "wire.log")
    assert (again.returncode, "wire.log: exists. Choose another name for --wire-log" in again.stderr) == (6, True)
    assert (tmp_path / "wire.log").read_text() == text


def test_a_thorough_examination_has_a_wire_log(nlos: Nlos, tmp_path: Path) -> None:
    done = nlos("doctor", "--thorough", "-o", "page.html", "--wire-log", "wire.log")
    assert "File exists" not in done.stdout + done.stderr
    assert done.returncode == 0, done.stdout
    assert OPENED.search((tmp_path / "wire.log").read_text())


def test_devices_of_a_simulated_bench_are_logged(nlos: Nlos, tmp_path: Path) -> None:
    nlos("devices", "--wire-log", "wire.log", check=True)
    assert OPENED.search((tmp_path / "wire.log").read_text())


@pytest.mark.parametrize("words", [["--wire-log", "--json"], ["--json", "--wire-log="], ["--json", "--wire-log", ""],
                                   ["--json", "--wire-log"]])  # fmt: skip
def test_an_option_or_nothing_is_no_file_for_it(nlos: Nlos, tmp_path: Path, words: list[str]) -> None:
    done = nlos("patterns", *words)
    assert (done.returncode, "--wire-log needs a file" in done.stderr) == (2, True)
    assert json.loads(done.stdout)["error"]["exit_code"] == 2
    assert list(tmp_path.iterdir()) == []
