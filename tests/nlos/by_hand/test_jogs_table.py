"""The table of spots while `nlos jog` runs: a person may correct it, or put it away, in another window."""

import csv
from pathlib import Path

import pytest

from nlos.__main__ import run
from tests.nlos.by_hand.at_a_terminal import at_a_terminal
from tests.nlos.by_hand.witness import bench_file


def test_a_table_that_is_spoilt_or_put_away_while_jog_runs_ends_nothing(tmp_path: Path) -> None:
    table = tmp_path / "spots.csv"
    words = ("jog", "--bench", str(bench_file(tmp_path)), "--marks", table.name)
    with at_a_terminal(tmp_path, *words) as child:
        child.wait_until(lambda: bool(child.frames), "a screen")
        child.press("m", "0 0", "\r")
        child.wait_for("spot 1 in spots.csv")
        table.write_text("x,y\n")
        child.press("m", "0 0", "\r")
        child.wait_for("not marked: spots.csv: its header has no column")
        table.write_bytes(b"PK\x03\x04\xff\xfe")  # saved as a spreadsheet's own file
        child.press("m", "0 0", "\r")
        child.wait_for("not marked: spots.csv is no text, so no table of spots")
        table.unlink()
        child.press("m", "0 0.001", "\r")
        child.wait_until(table.exists, "a new table")
        child.press("q")
        assert child.ends() == 0
        assert "spots.csv: 1 spots" in child.said
    assert [row["y_m"] for row in csv.DictReader(table.open())] == ["0.00100"]


def test_scans_are_not_told_of_a_mark_that_was_misread_and_deleted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = bench_file(tmp_path, {"simulation": {"misalignment": {"scanner_x_m": 0.001}}})
    table = tmp_path / "spots.csv"

    def written() -> int:
        return table.read_text().count("\n") if table.exists() else 1

    with at_a_terminal(tmp_path, "jog", "--bench", str(path), "--marks", table.name) as child:
        child.wait_until(lambda: bool(child.frames), "a screen")
        for place, shown, ruler in (
            ("0 0", "+0.0000   y   +0.0000 m", ""),
            ("0 0.2", "+0.0000   y   +0.2000 m", ""),
            ("0.2 0", "+0.2000   y   +0.0000 m", "-0.2 0"),
            ("0.2 0.1", "+0.2000   y   +0.1000 m", ""),
        ):
            child.press("g", place, "\r")
            child.wait_for(shown)
            marked = written()
            child.press("m", ruler, "\r")
            child.wait_until(lambda: written() > marked, "a mark")  # noqa: B023 - called at once
            if ruler:
                table.write_text("\n".join(table.read_text().splitlines()[:-1]) + "\n")
        child.wait_for("spot 3 in spots.csv")
        child.press("q")
        assert child.ends() == 0
    assert run(["plan", "demo", "--bench", str(path)]) == 0
    assert "nlos jog" not in capsys.readouterr().err
