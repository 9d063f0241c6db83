"""The journal of a series: what each line means, whatever became of the file; and what is said of the whole."""

import errno
import json
import os
from pathlib import Path

import pytest

from nlos.series.carry_out import _duration
from nlos.series.journal import (
    ALARM,
    BEGUN,
    CUT_OFF,
    DONE,
    INTERRUPTED,
    NO_PICTURE,
    PICTURE,
    PLAN,
    WAITING,
    Journal,
    planned,
    read,
)


def test_a_picture_or_the_lack_of_one_is_no_outcome_of_a_scan(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    assert journal.outcome("1-hat") == WAITING
    for what, outcome in ((BEGUN, CUT_OFF), (INTERRUPTED, INTERRUPTED), (BEGUN, CUT_OFF), (DONE, DONE),
                          (NO_PICTURE, DONE), (PICTURE, DONE), (BEGUN, CUT_OFF), (ALARM, ALARM)):  # fmt: skip
        journal.add("1-hat", what)
        assert journal.outcome("1-hat") == Journal(tmp_path).outcome("1-hat") == outcome
    assert journal.outcome("2-cap") == WAITING


@pytest.mark.parametrize(
    ("lines", "has"),
    [
        ([BEGUN, DONE], None),
        ([BEGUN, DONE, PICTURE], True),
        ([BEGUN, DONE, PICTURE, BEGUN, DONE], False),
        ([BEGUN, DONE, PICTURE, BEGUN, DONE, NO_PICTURE], False),
        ([BEGUN, DONE, NO_PICTURE, PICTURE], True),
    ],
)
def test_of_which_recording_a_picture_is_is_told_by_no_clock(
    tmp_path: Path, lines: list[str], has: bool | None
) -> None:
    journal = Journal(tmp_path)
    for what in lines:
        journal.add("1-hat", what)
        journal.add("2-cap", DONE)
    assert journal.has_picture("1-hat") is has


@pytest.mark.parametrize("harm", [b"\xff\xfe\n", b"[1, 2]\n", b"{}\n", b"null\n", b'{"at": "2026-0', b"\0" * 512])
def test_what_is_no_line_costs_no_other(tmp_path: Path, harm: bytes) -> None:
    journal = Journal(tmp_path)
    journal.add("1-hat", DONE, "digest", "a\nmessage", 0)
    with journal.path.open("ab") as file:
        file.write(harm)
    Journal(tmp_path).add("2-cap", ALARM, "digest", "too bright", 5)
    found = read(journal.path)
    assert [(line.run, line.what, line.message, line.exit_code) for line in found] == [
        ("1-hat", DONE, "a message", 0), ("2-cap", ALARM, "too bright", 5)
    ]  # fmt: skip


def test_a_line_of_which_the_disk_takes_a_part_is_whole_or_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A disk with room for a part of it takes that, and refuses at the next try."""
    room, real = [20], os.write

    def writes(number: int, data: bytes) -> int:
        if not room[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = real(number, data[: room[0]])
        room[0] -= taken
        return taken

    monkeypatch.setattr(os, "write", writes)
    journal = Journal(tmp_path)
    journal.add("1-hat", DONE)
    assert "journal.jsonl: cannot be written (No space left on device): 1-hat done" in capsys.readouterr().err
    room[0] = 1000
    journal.add("2-cap", DONE)
    assert [line.run for line in read(journal.path)] == ["2-cap"]
    assert not capsys.readouterr().err


def test_a_journal_that_the_disk_does_not_take_is_said_and_ends_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    journal = Journal(tmp_path / "gone")
    journal.add("1-hat", DONE)
    journal.plan({"1-hat": 1.0})
    said = capsys.readouterr().err
    assert "journal.jsonl: cannot be written (No such file or directory): 1-hat done" in said
    assert f"{PLAN}: cannot be written (" in said
    assert "no such folder" in said
    assert journal.outcome("1-hat") == DONE  # for as long as the program runs


def test_a_plan_for_which_there_is_no_room_is_said_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(path: Path, text: str, encoding: str) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    Journal(tmp_path).plan({"1-hat": 1.0})
    said = capsys.readouterr().err
    assert f"{PLAN}: cannot be written (No space left on device)" in said
    assert said.count("cannot be written") == 1
    assert "with -o" not in said  # a queue has none


def test_a_plan_is_in_the_order_of_the_runs_and_none_where_it_is_none(tmp_path: Path) -> None:
    Journal(tmp_path).plan({"2-cap": 3.5, "1-hat": 0.0})
    assert list(planned(tmp_path).items()) == [("2-cap", 3.5), ("1-hat", 0.0)]
    for text in ("[]", "{", '{"1-hat": "soon"}', '{"1-hat": null}', json.dumps("1-hat")):
        (tmp_path / PLAN).write_text(text)
        assert planned(tmp_path) == {}
    (tmp_path / PLAN).unlink()
    assert planned(tmp_path) == {}


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.4, "0 min 00 s"), (59.6, "1 min 00 s"), (3599, "59 min 59 s"), (3600, "1 h 00 min"), (36_119, "10 h 01 min")],
)
def test_how_long_a_series_takes_is_said_in_hours_or_minutes(seconds: float, said: str) -> None:
    assert _duration(seconds) == said
