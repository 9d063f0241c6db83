"""An archive on a disk that refuses its record: every file is done, and what an earlier record says is kept."""

import errno
import json
import os
import threading
from pathlib import Path

import pytest

from nlos.acquisition.errors import StorageError
from nlos.cli import archive_record
from nlos.cli.archive_record import ArchiveRecord
from nlos.cli.archive_task import Outcome, Task
from nlos.recipe import Recipe
from nlos.results_folder import ResultsFolder

TASKS = [Task(f"{name}.h5", Path(f"{name}.h5"), Recipe("lct"), ResultsFolder(Path("out") / name)) for name in "abc"]


def done_with(record: ArchiveRecord) -> None:
    """As an archive goes on."""
    record.begin(TASKS)
    with record:
        for task in TASKS:
            record.add(task, Outcome(task.file, "done", "", 0, 1.0, "here"))


@pytest.mark.parametrize("until_the_end", [False, True])
def test_a_record_that_is_refused_for_a_while_ends_nothing(
    until_the_end: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first refusal ended the archive, by an error that named nothing."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(archive_record, "EVERY_S", -1.0)
    calls, write_text = [0], Path.write_text

    def refused(path: Path, text: str, **how: str) -> int:
        if path.name.startswith(".archive.json"):
            calls[0] += 1
            if calls[0] > 1 and (until_the_end or calls[0] < 4):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return write_text(path, text, **how)

    monkeypatch.setattr(Path, "write_text", refused)
    if until_the_end:
        with pytest.raises(StorageError, match=r"^out/archive\.json: cannot be written \(No space.*Free disk space"):
            done_with(ArchiveRecord(Path("out")))
    else:
        done_with(ArchiveRecord(Path("out")))
    assert capsys.readouterr().err.count("archive.json: cannot be written") == 1
    kept = json.loads(Path("out/archive.json").read_bytes())
    assert {row["outcome"] for row in kept} == {"unfinished" if until_the_end else "done"}
    assert not [path.name for path in Path("out").iterdir() if path.name.startswith(".")]


def test_a_record_that_cannot_be_read_is_not_written_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it said of files that are no longer there was lost."""

    def broken(path: Path, **how: str) -> str:
        raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))

    monkeypatch.setattr(Path, "read_text", broken)
    with pytest.raises(StorageError, match=r"archive\.json: cannot be read .*Nothing was changed"):
        ArchiveRecord(tmp_path)


def test_a_row_that_another_call_writes_between_reading_and_replacing_the_record_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    one, other = ArchiveRecord(Path("out")), ArchiveRecord(Path("out"))
    meanwhile, read = threading.Thread(target=other.begin, args=(TASKS[1:],)), archive_record._read

    def read_slowly(path: Path) -> object:
        rows = read(path)
        if meanwhile.ident is None:
            meanwhile.start()
            meanwhile.join(0.3)  # it waits for its turn
        return rows

    monkeypatch.setattr(archive_record, "_read", read_slowly)
    one.begin(TASKS[:1])
    meanwhile.join()
    assert [row["file"] for row in json.loads(Path("out/archive.json").read_bytes())] == ["a.h5", "b.h5", "c.h5"]


def test_a_record_of_thousands_of_files_looks_at_each_name_a_few_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It compared each name with every other: ten thousand files took half a minute before the first was done."""
    looks = []
    monkeypatch.setattr(archive_record, "folded", lambda name: looks.append(name) or name.casefold())
    tasks = [Task(f"{k}.h5", Path(f"{k}.h5"), Recipe("lct"), ResultsFolder(tmp_path / f"Run {k}")) for k in range(200)]
    record = ArchiveRecord(tmp_path)
    record.begin(tasks)
    assert len(record.rows_of(tasks)) == len(tasks)
    assert len(looks) <= 5 * len(tasks)
