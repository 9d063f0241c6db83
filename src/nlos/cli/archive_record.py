"""archive.json and index.html of an archive: what became of every file, kept from one call to the next.

`archive.json` is a list of rows: `file`, `outcome` (done; partial: made without samples that are damaged; failed;
unfinished), `reason`, `code` (the exit code of that file alone), `seconds` (reading and drawing included),
`method_seconds`, `worker` (HOST:PID), `folder` (beside archive.json), `method`, `settings`, `options`, `input` (the
file as it was: path, bytes, modified_ns, sha256).
"""

import json
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.disk_refusal import disk_refusal
from nlos.acquisition.recording.writer_lock import WriterLock
from nlos.cli.archive_inputs import changed
from nlos.cli.archive_made_with import differences, made_with
from nlos.cli.archive_page import page
from nlos.cli.archive_task import Outcome
from nlos.cli.terminal import terminal
from nlos.names_for_one import folded
from nlos.recon.results import NAMES
from nlos.whole_file import whole_file

if TYPE_CHECKING:
    from nlos.cli.archive_task import Task

Row = dict[str, Any]
RECORD, PAGE = "archive.json", "index.html"
MADE = ("done", "partial")
"""Outcomes that come with results."""
EVERY_S = 1.0
"""archive.json is written so often while files are done, and at the end whatever ends it."""
WAITS_S = 10.0


class ArchiveRecord:
    """The record of one archive's folder: a row for each folder of results in it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.path = folder, folder / RECORD
        self._rows: dict[str, Row] = {}
        self._alike: defaultdict[str, set[str]] = defaultdict(set)
        """Names of folders, also of earlier ones, by what a disk may take for one: an archive has thousands."""
        self._know(_read(self.path))
        self._written_s = 0.0
        self._own: set[str] = set()
        """Rows of this call: another one at the same time has others."""
        self._said = ""

    def has(self, task: "Task", overwrite: bool, skip_existing: bool) -> bool:
        """Whether the task's results are there and may stay. Raises `FileExistsError` where they may neither stay nor
        be replaced. With `skip_existing`, half a result, of an attempt that was killed, is replaced, and so is one
        whose file has changed since."""
        there = [name for name in NAMES if (task.results.path / name).exists()]
        if not there or overwrite:
            return False
        if not skip_existing:
            raise FileExistsError(
                f"{task.results.path / there[0]}: exists. Choose another folder with -o, or use --skip-existing or "
                "--overwrite."
            )
        if len(there) < len(NAMES):
            return False
        row = self._row_of(task.results.path)
        if row is None:
            if _newer(task.run, task.results.path / NAMES[0]):
                terminal.log(f"{task.file}: newer than its result, done again")
                return False
            self._put(task, Outcome(task.file, "done", "was there already", 0, None, ""))
            return True
        if row["outcome"] not in MADE:
            return False
        if others := differences(row, made_with(task)):
            raise FileExistsError(
                f"{task.results.path}: holds a result of {row['method']} by other settings: {'; '.join(others)}. "
                "Choose another folder with -o, or use --overwrite."
            )
        return self._of_this_file(task, row)

    def _row_of(self, results: Path) -> Row | None:
        """What is known of a folder of results: also by another name, which its disk takes for the same."""
        others = (name for name in self._alike[folded(results.name)] if name in self._rows)
        known = (name for name in others if name == results.name or _is_same(self.folder / name, results))
        return next((self._rows[name] for name in known), None)

    def _know(self, rows: Iterable[Row]) -> None:
        for row in rows:
            self._rows[row["folder"]] = row
            self._alike[folded(row["folder"])].add(row["folder"])

    def _of_this_file(self, task: "Task", row: Row) -> bool:
        """Whether a result was made of the task's file as it is."""
        before = row["input"]
        if before is None:
            again = _newer(task.run, task.results.path / NAMES[0])
        else:
            again = changed(before, task.run)
            if again and before["path"] != str(task.run.absolute()):
                raise FileExistsError(
                    f"{task.results.path}: holds the result of another file, {before['path']}. Choose another "
                    "folder with -o, or use --overwrite."
                )
        if again:
            terminal.log(f"{task.file}: has changed since its result was made, done again")
        else:
            row["file"] = task.file
            self._own.add(row["folder"])
        return not again

    def forget_what_is_gone(self) -> None:
        """Rows without a result whose files are no longer there say nothing any more."""
        for name, row in list(self._rows.items()):
            places = {row["file"], (row["input"] or {}).get("path", row["file"])}
            if row["outcome"] not in MADE and not any(Path(str(place)).exists() for place in places):
                terminal.log(f"{row['file']}: is no longer there; {RECORD} forgets it ({row['outcome']})")
                self._forget(name)

    def begin(self, tasks: Iterable["Task"]) -> None:
        """These are done now. Until they are, each is unfinished, whatever ends this process."""
        self.folder.mkdir(parents=True, exist_ok=True)
        for task in tasks:
            to_come = Outcome(task.file, "unfinished", "the command ended before it was done", 130, None, "")
            if (before := self._row_of(task.results.path)) is not None:
                self._forget(before["folder"])
            self._put(task, to_come)
        self.write()

    def add(self, task: "Task", outcome: Outcome) -> None:
        """One more file has an outcome. A disk that does not take the record now may do so at the end: until then the
        other files are done."""
        self._put(task, outcome)
        if time.monotonic() - self._written_s > EVERY_S:
            self._written_s = time.monotonic()
            try:
                self.write()
            except OSError as error:
                self._refused(error)

    def _put(self, task: "Task", outcome: Outcome) -> None:
        self._know([_row(task, outcome)])
        self._own.add(task.results.path.name)

    def _forget(self, name: str) -> None:
        del self._rows[name]
        self._own.add(name)

    def rows_of(self, tasks: Iterable["Task"]) -> list[Row]:
        """The rows of these tasks."""
        return [row for task in tasks if (row := self._row_of(task.results.path)) is not None]

    def write(self) -> None:
        """Replaces archive.json at once: a reader meets the old one or the new one. What another call has written into
        it meanwhile stays. Raises `StorageError`."""
        with _alone(self.path):
            self._know(row for row in _read(self.path) if row["folder"] not in self._own)
            _replace(self.path, json.dumps(self._in_order(), indent=1) + "\n")
        self._written_s = time.monotonic()

    def _in_order(self) -> list[Row]:
        return sorted(self._rows.values(), key=lambda row: str(row["file"]))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.write()
            _replace(self.folder / PAGE, page(self._in_order()))
        except OSError as error:
            if kind is None:
                raise
            self._refused(error)  # what ended the archive is said, and not what came of it

    def _refused(self, error: OSError) -> None:
        if str(error) != self._said:
            terminal.log(f"warning: {error}", -1)
        self._said = str(error)


def _row(task: "Task", outcome: Outcome) -> Row:
    return {
        "file": task.file, "outcome": outcome.outcome, "reason": outcome.reason, "code": outcome.code,
        "seconds": outcome.seconds, "method_seconds": outcome.method_s, "worker": outcome.worker,
        "folder": task.results.path.name, **made_with(task), "input": outcome.source,
    }  # fmt: skip


def _is_same(folder: Path, other: Path) -> bool:
    try:
        return folder.samefile(other)
    except OSError:
        return False


def _newer(run: Path, result: Path) -> bool:
    """Whether a file was written after a result of an earlier version, which did not keep what it was made of."""
    try:
        return run.stat().st_mtime_ns > result.stat().st_mtime_ns
    except OSError:
        return False


def _read(path: Path) -> Sequence[Row]:
    """The rows of an earlier call; none where there is no such file, or nothing that makes sense. Raises `StorageError`
    where the disk does not give it: it would be written anew, without them. Earlier versions wrote a folder's whole
    path, which is wrong once it is moved."""
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        if refused := disk_refusal(path, error):
            raise refused from error
        terminal.log(f"{path}: not readable ({error}); it is written from scratch")
        return []
    if not isinstance(held, list):
        return []
    needed = {"file", "outcome", "reason", "code", "seconds", "folder", "method", "settings"}
    rows = [row for row in held if isinstance(row, dict) and needed <= row.keys() and isinstance(row["settings"], dict)]
    return [{"input": None, **row, "folder": Path(str(row["folder"])).name} for row in rows]


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """While no other call is between reading and replacing it; after `WAITS_S`, or on a disk that has no locks, all the
    same: a row is lost then where two do so at once."""
    lock, until_s = None, time.monotonic() + WAITS_S
    while lock is None and time.monotonic() < until_s:
        try:
            lock = WriterLock(path)
        except StorageError as error:
            if error.__cause__ is not None:  # it is the disk that refuses, and no other call that has it
                break
    try:
        yield
    finally:
        if lock is not None:
            lock.release()


def _replace(path: Path, text: str) -> None:
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
