"""The index of a folder of recordings: SQLite beside no data, made from the files alone and never believed over them.

It lies in the state folder, one file a data folder; deleting it loses nothing. Files are told apart by size, time and
inode: those that have changed are read again, by a child, and those that are gone are dropped.
"""

import hashlib
import json
import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from nlos.acquisition.errors import StorageError
from nlos.drivers.state_folder import state_folder
from nlos.runs.query import OTHER, UNREADABLE, condition

_VERSION = 2
_SCHEMA = """
CREATE TABLE runs (
    path TEXT PRIMARY KEY, size INTEGER, mtime_ns INTEGER, inode INTEGER, kind TEXT, started TEXT, status TEXT,
    points INTEGER, planned INTEGER, photons INTEGER, live_s REAL, sample TEXT, operator TEXT, note TEXT, tags TEXT,
    bench TEXT, words TEXT
) WITHOUT ROWID;
CREATE TABLE summaries (path TEXT PRIMARY KEY, summary TEXT);
CREATE INDEX by_start ON runs (started);
"""
_COLUMNS = ("path", "size", "mtime_ns", "inode", "kind", "started", "status", "points", "planned", "photons", "live_s",
            "sample", "operator", "note", "tags", "bench", "words")  # fmt: skip
SORTS = ("started", "path", "status", "points", "photons", "live_s", "sample", "operator", "bench")


@dataclass(frozen=True)
class Changes:
    """What an update found."""

    read: int
    gone: int
    unreadable: int


@dataclass(frozen=True)
class Run:
    """One recording of a list. `path` is relative to the folder; `summary` as `summarise` gives it."""

    path: str
    started: str
    """Local time, to the second; empty where the file does not say."""
    status: str
    summary: dict[str, Any]


class RunsIndex:
    """The index of `folder`, opened, made where there is none or where it is no index."""

    def __init__(self, folder: Path, place: Path | None = None) -> None:
        self.folder = folder.resolve()
        name = hashlib.sha256(str(self.folder).encode()).hexdigest()[:16]
        self.place = place or state_folder() / "runs" / f"{name}.sqlite"
        self._base = self._opened()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._base.close()

    def _opened(self) -> sqlite3.Connection:
        try:
            self.place.parent.mkdir(parents=True, exist_ok=True)
            base = sqlite3.connect(self.place, timeout=30.0)
            try:
                if base.execute("PRAGMA user_version").fetchone()[0] == _VERSION:
                    base.execute("SELECT path FROM runs LIMIT 1").fetchone()
                    return base
            except sqlite3.DatabaseError as error:
                if isinstance(error, sqlite3.OperationalError) and "locked" in str(error):
                    base.close()
                    raise
            base.close()
            for left in (self.place, *self.place.parent.glob(f"{self.place.name}-*")):
                left.unlink(missing_ok=True)
            base = sqlite3.connect(self.place, timeout=30.0)
            base.executescript(f"{_SCHEMA}PRAGMA user_version = {_VERSION};")
            return base
        except (OSError, sqlite3.Error) as error:
            raise StorageError(f"{self.place}: the index of runs cannot be kept there ({error})") from error

    def rebuild(self) -> Changes:
        """From the files alone."""
        with self._base:
            self._base.execute("DELETE FROM runs")
            self._base.execute("DELETE FROM summaries")
        return self.update()

    def update(self) -> Changes:
        """Reads what is new or has changed, and drops what is gone. Raises `StorageError`."""
        try:
            return self._update()
        except sqlite3.Error as error:
            raise StorageError(f"{self.place}: the index of runs cannot be written ({error})") from error

    def _update(self) -> Changes:
        # One that was being written may have been killed since: its file does not show that.
        asked = "SELECT path, size, mtime_ns, inode, status = 'running' FROM runs"
        known = {path: () if running else tuple(stamp) for path, *stamp, running in self._base.execute(asked)}
        there = {path: (stat.st_size, stat.st_mtime_ns, stat.st_ino) for path, stat in _recordings(self.folder)}
        gone = [(path,) for path in known.keys() - there.keys()]
        fresh = sorted(path for path, stamp in there.items() if known.get(path) != stamp)
        with self._base:
            for table in ("runs", "summaries"):
                self._base.executemany(f"DELETE FROM {table} WHERE path = ?", gone)
        unreadable = 0
        if fresh:
            from nlos.runs.reading import read_in_batches  # NumPy and HDF5: nothing that a search needs

            marks = ", ".join("?" * len(_COLUMNS))
            for rows in read_in_batches(self.folder, {path: there[path] for path in fresh}):
                unreadable += sum(row[_COLUMNS.index("kind")] == UNREADABLE for row, _ in rows)
                with self._base:
                    self._base.executemany(f"INSERT OR REPLACE INTO runs VALUES ({marks})", [row for row, _ in rows])
                    summaries = [(row[0], summary) for row, summary in rows]
                    self._base.executemany("INSERT OR REPLACE INTO summaries VALUES (?, ?)", summaries)
        return Changes(len(fresh), len(gone), unreadable)

    def search(
        self, words: Sequence[str] = (), sort: str = "started", reverse: bool = True, limit: int | None = None
    ) -> list[Run]:
        """Recordings that every word fits, the latest first unless told. Raises `UsageError` for a word that means
        nothing."""
        where, values = condition(words)
        order = f"{sort} {'DESC' if reverse else 'ASC'}, path {'DESC' if reverse else 'ASC'}"
        found = f"SELECT * FROM runs WHERE kind != ? AND {where} ORDER BY {order} LIMIT ?"
        asked = f"SELECT path, started, status, summary FROM ({found}) JOIN summaries USING (path) ORDER BY {order}"
        with closing(self._base.execute(asked, (OTHER, *values, -1 if limit is None else limit))) as rows:
            return [Run(path, started, status, json.loads(summary)) for path, started, status, summary in rows]

    def count(self) -> int:
        """How many runs there are in all."""
        return int(self._base.execute("SELECT count(*) FROM runs WHERE kind != ?", (OTHER,)).fetchone()[0])


def _recordings(folder: Path) -> Iterator[tuple[str, os.stat_result]]:
    """Every file below `folder` that may be a recording, by its path relative to it; hidden ones are skipped."""
    left = [""]
    while left:
        here = left.pop()
        try:
            entries = list(os.scandir(folder / here))
        except OSError:
            continue
        for entry in entries:
            name = entry.name
            if name.startswith("."):
                continue
            try:
                if entry.is_dir(follow_symlinks=False):
                    left.append(f"{here}{name}/")
                elif name.endswith(".h5") and name != "reconstruction.h5" and entry.is_file():
                    yield f"{here}{name}", entry.stat()
            except OSError:
                continue
