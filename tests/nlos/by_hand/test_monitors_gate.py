"""`nlos monitor --gate`: a part of the laser's period."""

import csv
from pathlib import Path

import pytest

from nlos.__main__ import run
from nlos.cli.terminal import terminal
from tests.nlos.by_hand.witness import bench_file


@pytest.fixture(autouse=True)
def fresh_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("as_json", False), ("verbosity", 0), ("wire_log", None), ("document", {})):
        monkeypatch.setattr(terminal, name, value)


@pytest.mark.parametrize(("gate", "holds_it"), [("12.5:15", True), ("80:99", False)])
def test_a_part_of_the_period_is_watched(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], gate: str, holds_it: bool
) -> None:
    log, path = tmp_path / "log.csv", bench_file(tmp_path)
    words = ["monitor", "--bench", str(path), "--at", "0", "0", "--light", "1", "--for", "1.2", "--gate", gate]
    assert run([*words, "--log", str(log)]) == 0
    found = [float(row["direct_ns"]) for row in csv.DictReader(log.open()) if row["direct_ns"]]
    assert bool(found) == holds_it
    assert found == pytest.approx([13.69] * len(found), abs=0.05)


@pytest.mark.parametrize(
    ("gate", "why"),
    [
        ("x:3", "two times in ns"),
        ("10", "two times in ns"),
        ("1:2:3", "two times in ns"),
        ("5:5", "end after its beginning"),
        ("-1:4", "begin at 0 or later"),
        ("0:inf", "end after its beginning"),
        ("nan:4", "end after its beginning"),
        ("100:120", "must begin within the laser's period of 100 ns"),
    ],
)
def test_what_is_no_part_of_the_period_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], gate: str, why: str
) -> None:
    assert run(["monitor", "--bench", str(bench_file(tmp_path)), "--for", "0.2", f"--gate={gate}"]) == 2
    assert why in capsys.readouterr().err
