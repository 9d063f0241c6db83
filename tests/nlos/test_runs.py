"""Runs are found again: what was said of them is kept with them, and the index is what the files say."""

import json
import os
import re
import shutil
import sqlite3
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace

import h5py
import pytest

from nlos.__main__ import run
from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.run_notes import RunNotes
from nlos.acquisition.recording.salvage import recover
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.cli.exit_codes import UsageError
from nlos.configs.load import load
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.run_defaults import RunDefaults
from nlos.report.scan_part import _about
from nlos.run_defaults import dated_name, notes_for
from nlos.runs.database import Row, keep
from nlos.runs.index import RunsIndex
from nlos.runs.page import page
from nlos.status_page import body
from tests.acquisition.test_recording import plan_of, sample_of
from tests.nlos.conftest import SMALL

BENCH = load("bench", "simulated", BenchSettings).settings
NOTES = RunNotes.of("A hat", "Ada", "100 % cotton <script>alert(1)</script>", ["night", "hat"])


@pytest.fixture(autouse=True)
def no_defaults_of_ones_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    folder = tmp_path / "config"
    folder.mkdir()
    monkeypatch.setenv("NLOS_CONFIG", str(folder))
    return folder


def recording(path: Path, notes: RunNotes, status: Status = Status.COMPLETE, started: str = "") -> Path:
    """A recording of a few points; one that says it is running is what a crash leaves."""
    path.parent.mkdir(parents=True, exist_ok=True)
    plan = plan_of()
    header = Header(bench_json=BENCH.model_dump_json(), notes=notes, started_utc=started)
    writer = RecordingWriter.create(path, plan, header)
    for number in range(len(plan)):
        writer.write(sample_of(plan, number))
    writer.finish(status)
    return path


def test_a_scan_keeps_what_was_said_of_it(
    tmp_path: Path, no_defaults_of_ones_own: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    data = tmp_path / "data"
    (no_defaults_of_ones_own / "defaults.yaml").write_text(
        f"operator: Ada\nsample: none\ntags: [own]\nfolder: {data}\n"
    )
    Path("small.yaml").write_text(SMALL)
    said = ["--sample", "A hat / cap", "--note", "with feather", "--tag", "night,red", "--tag", "night"]
    assert run(["scan", "small.yaml", *said]) == 0
    (path,) = data.rglob("*.h5")
    assert path.parent.name == f"{datetime.now():%Y-%m-%d}"
    assert path.name.endswith("-small-A-hat-cap.h5")
    with Recording.open(path) as held:
        assert held.header.notes == RunNotes("A hat / cap", "Ada", "with feather", ("night", "own", "red"))
    capsys.readouterr()
    assert run(["info", str(path)]) == 0
    out = capsys.readouterr().out
    assert all(word in out for word in ("A hat / cap", "Ada", "with feather", "night, own, red"))
    with Recording.open(path) as held:
        assert "<td>A hat / cap</td>" in _about(held)
    recover(path, tmp_path / "copy.h5")
    with Recording.open(tmp_path / "copy.h5") as held:
        assert held.header.notes.note == "with feather"
    assert run(["runs", "feather", "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [each["sample"] for each in found["runs"]] == ["A hat / cap"]


def test_what_is_said_goes_before_bench_and_person(
    no_defaults_of_ones_own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (no_defaults_of_ones_own / "defaults.yaml").write_text("operator: Ada\nnote: mine\ntags: [own]\n")
    bench = BENCH.model_copy(update={"runs": RunDefaults(operator="Bea", sample="hat", tags=("table",), folder="/d")})
    assert notes_for(bench, None, None, None, []) == RunNotes("hat", "Bea", "mine", ("own", "table"))
    assert notes_for(bench, "cap", "", None, ["x"]) == RunNotes("cap", "", "mine", ("own", "table", "x"))
    now = datetime(2026, 3, 1, 14, 32, 5)
    assert dated_name(bench, "demo", "a b/c", now) == Path("/d/2026-03-01/143205-demo-a-b-c.h5")
    long = dated_name(BENCH, "\u65e5\u672c\u8a9e" * 40, "\u65e5" * 90, now).name
    assert len(long.encode()) < 150
    assert long.startswith("\u65e5\u672c\u8a9e")
    assert long.endswith("-20260301-143205.h5")
    assert dated_name(BENCH, "demo", "", now) == Path("demo-20260301-143205.h5")
    monkeypatch.chdir(tmp_path)
    for number in ("", "-2", "-3"):  # the hour that comes twice as summer time ends
        found = dated_name(BENCH, "demo", "", now)
        assert found == Path(f"demo-20260301-143205{number}.h5")
        found.touch()
    for wrong in (["two words"], ["x" * 61], [f"t{n}" for n in range(40)]):
        with pytest.raises(UsageError, match="tag"):
            notes_for(bench, None, None, None, wrong)
    with pytest.raises(UsageError, match="10000 at most"):
        notes_for(bench, None, None, "x" * 10_001, [])


def test_recordings_of_before_there_were_notes_are_read(tmp_path: Path) -> None:
    path = recording(tmp_path / "old.h5", NOTES)
    with h5py.File(path, "r+") as file:
        del file["header/run_json"]
    with Recording.open(path) as held:
        assert held.header.notes == RunNotes()
        assert held.header.identity
    with RunsIndex(tmp_path) as index:
        assert (index.update().read, index.update().read) == (1, 0)
        assert index.search()[0].summary["sample"] == ""


def test_the_index_follows_the_files(tmp_path: Path) -> None:
    data = tmp_path / "data"
    recording(data / "a" / "done.h5", NOTES, started="2026-03-01T12:00:00+00:00")
    recording(data / "b" / "stopped.h5", RunNotes.of("cap"), Status.STOPPED, "2026-04-02T12:00:00+00:00")
    recording(data / "killed.h5", RunNotes.of("hut"), Status.RUNNING, "2026-05-03T12:00:00+00:00")
    damaged = recording(data / "damaged.h5", RunNotes.of("lost"))
    damaged.write_bytes(damaged.read_bytes()[:30_000])
    with h5py.File(data / "other.h5", "w") as file:
        file["x"] = 1
    (data / "text.h5").write_text("no HDF5")
    with RunsIndex(data) as index:
        changes = index.update()
        assert (changes.read, changes.gone, changes.unreadable) == (6, 0, 1)
        status = {each.path: each.status for each in index.search()}
        assert status == {"a/done.h5": "complete", "b/stopped.h5": "stopped", "killed.h5": "cut off",
                          "damaged.h5": "unreadable"}  # fmt: skip
        assert index.update() == type(changes)(0, 0, 0)
        shutil.move(data / "a" / "done.h5", data / "b" / "moved.h5")
        (data / "killed.h5").unlink()
        recording(data / "new.h5", RunNotes.of("new"))
        changes = index.update()
        assert (changes.read, changes.gone) == (2, 2)
        before = index.search()
        assert {each.path for each in before} == {"b/moved.h5", "b/stopped.h5", "damaged.h5", "new.h5"}
        assert index.update(afresh=True).read == 6
        assert index.search() == before
        place = index.place
    place.write_bytes(b"this is no database" * 100)
    with RunsIndex(data) as index:
        index.update()
        assert index.search() == before


@pytest.mark.parametrize(
    ("inode", "mtime_ns"),
    [(2**64 - 3, 0), (5, -11_644_473_600 * 10**9), (5, 13_569_465_600 * 10**9)],
    ids=["a network mount", "1601", "2400"],
)
def test_files_of_any_number_and_time_are_listed_and_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, inode: int, mtime_ns: int
) -> None:
    recording(tmp_path / "a.h5", NOTES)

    def stat_of_a_mount(folder: Path) -> list[tuple[str, object]]:
        found = (tmp_path / "a.h5").stat()
        return [("a.h5", SimpleNamespace(st_size=found.st_size, st_mtime_ns=mtime_ns, st_ino=inode))]

    monkeypatch.setattr("nlos.runs.index._recordings", stat_of_a_mount)
    with RunsIndex(tmp_path) as index:
        assert index.update().read == 1
        assert [each.path for each in index.search()] == ["a.h5"]
        assert index.update().read == 0


def test_a_search_loads_nothing_that_only_reading_needs(tmp_path: Path) -> None:
    recording(tmp_path / "a.h5", NOTES)
    with RunsIndex(tmp_path) as index:
        index.update()
    asked = (
        "import sys\nfrom nlos.__main__ import run\n"
        f"assert run(['runs', 'hat', '--folder', {str(tmp_path)!r}]) == 0\n"
        "print([name for name in ('numpy', 'h5py', 'yaml', 'nlos.drivers.bench') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    assert "1 of 1 runs" in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="file names are Unicode there")
def test_a_name_that_is_no_unicode_is_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = recording(tmp_path / "whole.h5", NOTES)
    shutil.copyfile(whole, tmp_path / os.fsdecode(b"caf\xe9.h5"))
    for _ in range(2):
        assert run(["runs", "--folder", str(tmp_path), "--page", str(tmp_path / "p.html"), "--overwrite"]) == 0
        said = capsys.readouterr().out
        assert "2 of 2 runs" in said
        assert r"  caf\xe9.h5  " in said  # as every other verb writes it
    with RunsIndex(tmp_path) as index:
        assert index.update().read == 0
        assert {each.path for each in index.search(["path:.h5"])} == {"whole.h5", os.fsdecode(b"caf\xe9.h5")}


def test_odd_names_keep_their_lines_and_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Those that a terminal shows wide, in no column of their own, or as an end of the line."""
    wide = {"plain.h5": 0, "two\nlines.h5": 0, "tab\there.h5": 0, "\x1b[31mred.h5": 0, "測定.h5": 2, "e\u0301t.h5": -1}
    for name in wide:
        recording(tmp_path / name, RunNotes.of("s", "o", "here it begins", []))
    assert run(["runs", "--folder", str(tmp_path)]) == 0
    head, *lines, _ = capsys.readouterr().out.splitlines()
    found = {line[head.index("path") :].split("  ")[0]: line.index("here it begins") for line in lines}
    said = {
        name.replace("\n", r"\n").replace("\t", r"\t").replace("\x1b", r"\x1b"): more for name, more in wide.items()
    }
    assert found == {name: head.index("note") - more for name, more in said.items()}


def test_what_is_damaged_in_the_index_is_made_again_and_never_shown(tmp_path: Path) -> None:
    data = tmp_path / "data"
    for name in ("a", "b", "c"):
        recording(data / f"{name}.h5", RunNotes.of(f"sample {name}"))
    with RunsIndex(data) as index:
        index.update()
        right, place = index.search(), index.place
    harms = (
        "UPDATE runs SET sample = 'another' WHERE path = 'b.h5'", "UPDATE summaries SET summary = '[]'",
        "DELETE FROM summaries WHERE path = 'a.h5'", "UPDATE runs SET path = 'd.h5' WHERE path = 'c.h5'",
        "UPDATE runs SET words = CAST(x'ff' AS TEXT)", "UPDATE runs SET words = CAST(x'6c6f636b6564ff' AS TEXT)",
        "ALTER TABLE runs RENAME COLUMN points TO pints",
        "DROP TABLE summaries", "PRAGMA user_version = 7",
    )  # fmt: skip
    schema = place.read_bytes()
    place.write_bytes(schema.replace(b"CREATE TABLE runs", b"CREATE TABLE \xdd\xddns"))
    with RunsIndex(data) as index:
        index.update()
        assert index.search() == right
    for harm in harms:
        with closing(sqlite3.connect(place, isolation_level=None)) as base:
            base.execute(harm)
        with RunsIndex(data) as index:
            index.update()
            assert index.search() == right, harm
            assert index.update().read == 0, harm
            assert index.not_kept is None, harm


def test_an_index_whose_pages_contradict_each_other_is_made_anew_before_anything_is_written(tmp_path: Path) -> None:
    data = tmp_path / "data"
    for name in ("a", "b"):
        recording(data / f"{name}.h5", RunNotes.of(f"sample {name}"))
    with RunsIndex(data) as index:
        index.update()
        place = index.place
    pages = bytearray(place.read_bytes())
    pages[32:40] = struct.pack(">II", 3, 1)  # the free pages: one, which holds the summaries
    place.write_bytes(pages)
    recording(data / "c.h5", RunNotes.of("sample c"))
    with RunsIndex(data) as index:
        assert index.update().read == 3
        assert index.not_kept is None
        assert sorted(each.summary["sample"] for each in index.search()) == ["sample a", "sample b", "sample c"]


def test_an_index_that_another_program_writes_is_left_alone_and_runs_are_found_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = tmp_path / "data"
    recording(data / "a.h5", RunNotes.of("hat"))
    with RunsIndex(data) as index:
        index.update()
        right, place = index.search(), index.place
    recording(data / "b.h5", RunNotes.of("cap"))
    held = place.read_bytes()
    monkeypatch.setattr("nlos.runs.database.WAIT_S", 0.01)
    for lock in ("EXCLUSIVE", "IMMEDIATE"):  # it is not read, or not written
        with closing(sqlite3.connect(place, isolation_level=None)) as other:
            other.execute(f"BEGIN {lock}")
            with RunsIndex(data) as index:
                index.update()
                assert {each.path for each in index.search()} == {"a.h5", "b.h5"}
                assert "locked" in str(index.not_kept)
        assert place.read_bytes() == held
    with RunsIndex(data) as index:
        assert index.search() == right
        assert index.update().read == 1
        held = place.read_bytes()
        with closing(sqlite3.connect(place, isolation_level=None)) as other:
            other.execute("BEGIN EXCLUSIVE")
            with pytest.raises(StorageError, match=r"cannot be read .*locked"):
                index.search()
        assert place.read_bytes() == held


SEARCHES = {
    (): {"hat", "cap", "plain"},
    ("HAT",): {"hat"},
    ("sample:hat",): {"hat"},
    ("sample:cotton",): set(),
    ("cotton", "ada"): {"hat"},
    ("100 %",): {"hat"},
    ("100_%",): set(),
    ("tag:night",): {"hat", "cap"},
    ("tag:nigh",): set(),
    ("2026-03",): {"hat"},
    ("since:2026-03-02",): {"cap"},
    ("since:2026-3-2",): {"cap"},
    ("until:2026-03",): {"hat"},
    ("until:2026-3",): {"hat"},
    ("until:2026-3-1",): {"hat"},
    ("since:2026-3-1", "until:2026-4-2"): {"hat", "cap"},
    ("since:2026", "until:2026-04-02"): {"hat", "cap"},
    ("status:complete", "simulated"): {"hat", "cap", "plain"},
    ("'; DROP TABLE runs; --",): set(),
}


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("three")
    recording(folder / "hat.h5", NOTES, started="2026-03-01T12:00:00+00:00")
    recording(folder / "cap.h5", RunNotes.of("cap", tags=["night"]), started="2026-04-02T12:00:00+00:00")
    recording(folder / "plain.h5", RunNotes())
    with RunsIndex(folder, folder / "index.sqlite") as index:
        index.update()
    return folder


@pytest.mark.parametrize("words", SEARCHES)
def test_words_find_runs(three: Path, words: tuple[str, ...]) -> None:
    with RunsIndex(three, three / "index.sqlite") as index:
        assert {Path(each.path).stem for each in index.search(words)} == SEARCHES[words]


def test_an_index_made_under_another_clock_shows_and_finds_what_this_one_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The laboratory's and a travelling laptop's: files are told apart by moments, days are those of whoever looks."""

    def clock(zone: str) -> None:
        monkeypatch.setenv("TZ", zone)
        time.tzset()

    try:
        clock("Asia/Tokyo")
        recording(tmp_path / "late.h5", NOTES, started="2026-03-01T20:00:00+00:00")
        with RunsIndex(tmp_path, tmp_path / "index.sqlite") as index:
            index.update()
            assert [each.started for each in index.search(["since:2026-03-02", "2026-03-02 05"])] == [
                "2026-03-02 05:00:00"
            ]
        clock("America/New_York")
        recording(tmp_path / "later.h5", NOTES, started="2026-03-01T21:00:00+00:00")
        with RunsIndex(tmp_path, tmp_path / "index.sqlite") as index:
            assert index.update().read == 1
            started = {each.path: each.started for each in index.search(["until:2026-03-01", "2026-03-01 1"])}
            assert started == {"later.h5": "2026-03-01 16:00:00", "late.h5": "2026-03-01 15:00:00"}
            assert index.search(["since:2026-03-02"]) == []
            assert index.search(["2026-03-02"]) == []
    finally:
        monkeypatch.undo()
        time.tzset()


def test_a_list_is_a_line_each_of_what_a_terminal_holds(
    three: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording(tmp_path / "long.h5", RunNotes.of("a  cap\nof wool", note="x" * 40 + "y"))
    recording(tmp_path / "short.h5", RunNotes.of("hat", note="z" * 40))
    assert run(["runs", "--folder", str(tmp_path), "--sort", "path", "--ascending"]) == 0
    head, *lines = capsys.readouterr().out.splitlines()
    assert head.split() == ["started", "status", "points", "sample", "operator", "tags", "path", "note"]
    assert [line.split()[-1] for line in lines[:2]] == ["x" * 39 + "…", "z" * 40]
    assert "  a cap of wool  " in lines[0]
    assert "  30/30  " in lines[0]
    assert lines[2] == f"2 of 2 runs in {tmp_path}"
    assert run(["runs", "--folder", str(three), "nothing-of-that-name"]) == 0
    assert capsys.readouterr().out == f"0 of 3 runs in {three}\n"


def test_a_page_of_runs_replaces_nothing_unasked(
    three: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "page.html"
    target.write_text("mine")
    asked = ["runs", "--folder", str(three), "--page", str(target), "--json"]
    assert run(asked) == 6
    assert target.read_text() == "mine"
    capsys.readouterr()
    assert run([*asked, "--overwrite", "tag:night"]) == 0
    assert json.loads(capsys.readouterr().out)["page"] == str(target)
    assert "2 runs in " in target.read_text()
    for wrong in (["--sort", "colour"], ["--page", str(tmp_path / "page.h5")], ["--folder", str(tmp_path / "gone")]):
        assert run(["runs", "--folder", str(three), *wrong]) == 2


def test_they_come_in_the_order_asked_for_and_no_more(three: Path) -> None:
    with RunsIndex(three, three / "index.sqlite") as index:
        assert [Path(each.path).stem for each in index.search()] == ["cap", "hat", "plain"]
        assert [Path(each.path).stem for each in index.search(sort="sample", reverse=False)] == ["plain", "hat", "cap"]
        assert len(index.search(limit=1)) == 1
        for wrong in ("colour:red", "since:yesterday"):
            with pytest.raises(UsageError, match=wrong.partition(":")[0]):
                index.search([wrong])


def test_the_page_has_a_card_and_a_picture_for_each_and_runs_no_script_of_a_note(three: Path) -> None:
    with RunsIndex(three, three / "index.sqlite") as index:
        html = page(three, index.search(), "words <b>", three)
    assert html.count("<article") == html.count("data:image/png;base64,") == 3
    assert "A hat" in html
    assert 'href="hat.h5"' in html
    assert "<script" not in html
    assert "words <b>" not in html
    cards = html.split("<article")[1:]  # of cap, hat, plain
    assert ["<p>Ada</p>" in each for each in cards] == [False, True, False]
    assert ["cotton &lt;script" in each for each in cards] == [False, True, False]
    assert [re.findall("<li>(.*?)</li>", each) for each in cards] == [["night"], ["hat", "night"], []]
    assert ["<ul>" in each for each in cards] == [True, True, False]
    assert all("30 of 30 points, " in each for each in cards)


def test_runs_are_found_where_their_index_cannot_be_kept_and_it_is_said_where_else_it_may(
    three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "home").touch()
    monkeypatch.setenv("NLOS_STATE", str(tmp_path / "home"))
    for more in ((), ("--rebuild",), ("hat",)):
        assert run(["runs", "--folder", str(three), "--json", *more]) == 0
        said = capsys.readouterr()
        assert len(json.loads(said.out.splitlines()[-1])["runs"]) == (1 if "hat" in more else 3)
        assert re.search(r"cannot be kept there .*name another folder by NLOS_STATE", said.err)
    assert "cannot be kept there" in body(three)


@pytest.mark.parametrize("why", ["attempt to write a readonly database", "database or disk is full"])
def test_runs_are_found_where_their_index_cannot_be_written_any_more(
    three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    folder, place = tmp_path / "folder", tmp_path / "index.sqlite"
    shutil.copytree(three, folder)
    with RunsIndex(folder, place) as index:
        index.update()
    shutil.copy(three / "hat.h5", folder / "again.h5")

    def refused(base: sqlite3.Connection, rows: Sequence[Row]) -> None:
        if base.execute("PRAGMA database_list").fetchone()[2]:
            raise sqlite3.OperationalError(why)
        keep(base, rows)

    monkeypatch.setattr("nlos.runs.index.keep", refused)
    with RunsIndex(folder, place) as index:
        index.update()
        assert len(index.search()) == 4
        assert why in str(index.not_kept)


def test_a_reader_that_does_not_start_makes_no_recording_unreadable(
    three: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(sys, "executable", "/nowhere/python")
        assert run(["runs", "--folder", str(three), "--rebuild"]) == 6
    said = capsys.readouterr()
    assert "no process could be started to read files in" in said.err
    assert run(["runs", "--folder", str(three), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])["runs"]
    assert len(found) == 3
    assert "unreadable" not in {each["status"] for each in found}
