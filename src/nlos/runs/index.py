"""The index of a folder of recordings: SQLite beside no data, made from the files alone and never believed over them.

It lies in the state folder, one file a data folder; deleting it loses nothing. Files are told apart by size, time and
inode: those that have changed are read again, by a child, and those that are gone are dropped. A damaged index is made
anew.
"""

import hashlib
import json
import os
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from nlos.acquisition.errors import StorageError
from nlos.drivers.state_folder import state_folder
from nlos.runs.database import (
    COLUMNS,
    DAMAGED,
    check_pages,
    checksum,
    drop,
    in_memory,
    is_in_use,
    keep,
    made,
    named_as,
    opened,
    stamp_of,
    stamps,
    storable,
)
from nlos.runs.query import OTHER, UNREADABLE, condition, local_time

SORTS = ("started", "path", "status", "points", "photons", "live_s", "sample", "operator", "bench")


@dataclass(frozen=True)
class Changes:
    """What an update found."""

    read: int
    gone: int
    unreadable: int


@dataclass(frozen=True)
class Run:
    """One recording of a list. `path` is relative to the folder, bytes that are no text as Python has them; `summary`
    as `summarise` gives it."""

    path: str
    started: str
    """Local time, to the second; empty where the file does not say."""
    status: str
    summary: dict[str, Any]

    def file(self, folder: Path) -> Path:
        """The recording itself, below the folder of the list."""
        return folder / self.path


class RunsIndex:
    """The index of `folder`, opened, made where there is none or where it is no index. Where it cannot be kept, all
    files are read into one that is gone with this object, and `not_kept` says why."""

    def __init__(self, folder: Path, place: Path | None = None) -> None:
        self.folder = folder.resolve()
        name = hashlib.sha256(os.fsencode(self.folder)).hexdigest()[:16]
        self.place = place or state_folder() / "runs" / f"{name}.sqlite"
        self.not_kept: StorageError | None = None
        try:
            self._base = opened(self.place)
        except (OSError, sqlite3.Error) as error:
            self._keep_in_memory("kept there", error)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._base.close()

    def _trouble(self, what: str, error: Exception) -> StorageError:
        said = error.strerror if isinstance(error, OSError) and error.strerror else error
        return StorageError(
            f"{self.place}: the index of runs cannot be {what} ({said}). Make that place writable for you, or name "
            "another folder by NLOS_STATE."
        )

    def update(self, afresh: bool = False) -> Changes:
        """Reads what is new or has changed - `afresh`: everything - and drops what is gone. Raises `StorageError`."""
        try:
            if not afresh:
                try:
                    return self._update()
                except DAMAGED as error:
                    if is_in_use(error):
                        raise
            self._base.close()
            self._base = made(self.place) if self.not_kept is None else in_memory()
            return self._update()
        except StorageError:
            raise  # there is no process to read recordings in: the index is as good as before
        except (OSError, sqlite3.Error) as error:
            if self.not_kept is not None:
                raise self._trouble("made", error) from error
            self._base.close()
            self._keep_in_memory("written", error)
            return self._update()

    def _keep_in_memory(self, what: str, error: Exception) -> None:
        self.not_kept, self._base = self._trouble(what, error), in_memory()

    def _update(self) -> Changes:
        known = stamps(self._base)
        named = {storable(path): (path, stat) for path, stat in _recordings(self.folder)}
        there = {path: stamp_of(stat) for path, (_, stat) in named.items()}
        gone = known.keys() - there.keys()
        fresh = sorted(path for path, stamp in there.items() if known.get(path) != stamp)
        if gone or fresh:
            check_pages(self._base)
        with self._base:
            drop(self._base, gone)
        unreadable = 0
        if fresh:
            from nlos.runs.reading import read_in_batches  # NumPy and HDF5: nothing that a search needs

            for found in read_in_batches(self.folder, {named[path][0]: there[path] for path in fresh}):
                unreadable += sum(row[COLUMNS.index("kind")] == UNREADABLE for row, _ in found)
                with self._base:
                    keep(self._base, found)
        return Changes(len(fresh), len(gone), unreadable)

    def search(
        self, words: Sequence[str] = (), sort: str = "started", reverse: bool = True, limit: int | None = None
    ) -> list[Run]:
        """Recordings that every word fits, the latest first unless told. Raises `UsageError` for a word that means
        nothing, `StorageError`."""
        where, values = condition(words)
        order = f"{sort} {'DESC' if reverse else 'ASC'}, path {'DESC' if reverse else 'ASC'}"
        found = f"SELECT * FROM runs WHERE kind != ? AND {where} ORDER BY {order} LIMIT ?"
        asked = (
            "SELECT path, started, status, summary, summary_crc "
            f"FROM ({found}) LEFT JOIN summaries USING (path) ORDER BY {order}"
        )
        given = (OTHER, *values, -1 if limit is None else limit)
        try:
            try:
                return [self._run(*row) for row in self._base.execute(asked, given).fetchall()]
            except DAMAGED as error:
                if is_in_use(error):
                    raise
            self.update(afresh=True)
            return [self._run(*row) for row in self._base.execute(asked, given).fetchall()]
        except sqlite3.Error as error:
            raise self._trouble("read", error) from error

    def _run(self, path: str, started: str, status: str, summary: str | None, crc: int | None) -> Run:
        if summary is None or checksum(summary) != crc:
            raise sqlite3.DatabaseError(f"the summary of {path} is damaged")
        return Run(named_as(self.folder, path), local_time(started), status, json.loads(summary))

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
