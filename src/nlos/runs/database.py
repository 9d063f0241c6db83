"""The SQLite file of an index of runs: opened where it is one, made anew where it is not, believed where checksums fit.

SQLite's pages have none, so each row has one; what is kept once, without an index beside it, cannot contradict itself.
"""

import os
import re
import sqlite3
import zlib
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from nlos.runs.query import local_time

Stamp = tuple[int, ...]
"""Size, time of change, inode; empty: to be read again."""
Row = tuple[tuple[Any, ...], str]
"""What is searched of a run, in the order of `COLUMNS`, and its summary."""
COLUMNS = ("path", "size", "mtime_ns", "inode", "kind", "started", "status", "points", "planned", "photons", "live_s",
           "sample", "operator", "note", "tags", "bench", "words")  # fmt: skip
DAMAGED = (sqlite3.DatabaseError, UnicodeDecodeError)
"""What a damaged file raises: the second where SQLite's own words quote bytes of it that are no text."""
WAIT_S = 10.0
"""For another program, which takes milliseconds. A network share without locks says that it is in use, too."""
_VERSION = 6
_SCHEMA = """
CREATE TABLE runs (
    path TEXT PRIMARY KEY, size INTEGER, mtime_ns INTEGER, inode INTEGER, kind TEXT, started TEXT, status TEXT,
    points INTEGER, planned INTEGER, photons INTEGER, live_s REAL, sample TEXT, operator TEXT, note TEXT, tags TEXT,
    bench TEXT, words TEXT, crc INTEGER
) WITHOUT ROWID;
CREATE TABLE summaries (path TEXT PRIMARY KEY, summary TEXT, summary_crc INTEGER) WITHOUT ROWID;
"""
_TABLES = "SELECT type, name, sql FROM sqlite_master ORDER BY name"
_SUMMED = " || '|' || ".join(f"coalesce({name}, '')" for name in COLUMNS)


def opened(place: Path) -> sqlite3.Connection:
    """The file at `place`, made where there is none or where it is no index. Raises OSError and `sqlite3.Error`."""
    place.parent.mkdir(parents=True, exist_ok=True)
    base = _connected(place)
    try:
        if base.execute("PRAGMA user_version").fetchone() == (_VERSION,) and _has_our_tables(base):
            return base
    except DAMAGED as error:
        if is_in_use(error):
            base.close()
            raise
    base.close()
    return made(place)


def made(place: Path) -> sqlite3.Connection:
    """A new one, of no runs, in the place of whatever lies there. Raises OSError and `sqlite3.Error`."""
    for left in (place, *place.parent.glob(f"{place.name}-*")):
        left.unlink(missing_ok=True)
    return _with_tables(_connected(place))


def in_memory() -> sqlite3.Connection:
    """One of no runs that is kept nowhere."""
    return _with_tables(_connected(":memory:"))


def _with_tables(base: sqlite3.Connection) -> sqlite3.Connection:
    base.executescript(f"{_SCHEMA}PRAGMA user_version = {_VERSION};")
    return base


def storable(text: str) -> str:
    """As SQLite keeps it: what is no UTF-8 - in a file's name, in a note - stands as `\\udcff`."""
    return text.encode("utf-8", "backslashreplace").decode()


def named_as(folder: Path, stored: str) -> str:
    """The name below `folder` that is kept as `stored`, as Python carries it."""
    meant = re.sub(r"\\u(dc[89a-f][0-9a-f])", lambda found: chr(int(found[1], 16)), stored)
    return stored if meant == stored or (folder / stored).exists() else meant  # a backslash of the name's own


def stamp_of(found: os.stat_result) -> tuple[int, int, int]:
    """Size, time of the last change and number of a file, as whole numbers of 64 bits with a sign, which SQLite has:
    some network mounts number files up to 2**64, and a wrong clock sets times before 1678 or after 2262."""
    return _signed(found.st_size), _signed(found.st_mtime_ns), _signed(found.st_ino)


def _signed(number: int) -> int:
    return (number + 2**63) % 2**64 - 2**63


def stamps(base: sqlite3.Connection) -> dict[str, Stamp]:
    """Path -> stamp of the file that a row was made from. One that was being written then is to be read again: a writer
    that was killed since does not show in its file's stamp. Raises `sqlite3.DatabaseError` where one is damaged."""
    found: dict[str, Stamp] = {}
    asked = f"SELECT path, size, mtime_ns, inode, status = 'running', crc, {_SUMMED} FROM runs"
    for path, *stamp, running, crc, summed in base.execute(asked):
        if crc != checksum(summed) or path in found:
            raise sqlite3.DatabaseError(f"the row of {path} is damaged")
        found[path] = () if running else tuple(stamp)
    return found


def drop(base: sqlite3.Connection, paths: Iterable[str]) -> None:
    """Raises `sqlite3.Error`."""
    for table in ("runs", "summaries"):
        base.executemany(f"DELETE FROM {table} WHERE path = ?", [(path,) for path in paths])


def keep(base: sqlite3.Connection, rows: Sequence[Row]) -> None:
    """Rows in the place of earlier ones of the same path. Raises `sqlite3.Error`."""
    marks = ", ".join("?" * len(COLUMNS))
    kept = [[storable(value) if isinstance(value, str) else value for value in row] for row, _ in rows]
    base.executemany(f"INSERT OR REPLACE INTO runs VALUES ({marks}, NULL)", kept)
    base.execute(f"UPDATE runs SET crc = checksum({_SUMMED}) WHERE crc IS NULL")  # of the values as SQLite keeps them
    summaries = [(row[0], summary, checksum(summary)) for row, (_, summary) in zip(kept, rows, strict=True)]
    base.executemany("INSERT OR REPLACE INTO summaries VALUES (?, ?, ?)", summaries)


def checksum(text: str) -> int:
    """CRC-32."""
    return zlib.crc32(text.encode("utf-8", "surrogatepass"))


def check_pages(base: sqlite3.Connection) -> None:
    """To be done before anything is written. Raises `sqlite3.DatabaseError` where pages contradict each other."""
    if (said := base.execute("PRAGMA quick_check(1)").fetchone()) != ("ok",):
        raise sqlite3.DatabaseError(str(said))


def is_in_use(error: Exception) -> bool:
    """Whether another program has kept us waiting, which says nothing about the file."""
    return isinstance(error, sqlite3.OperationalError) and "locked" in str(error)


def _connected(place: Path | str) -> sqlite3.Connection:
    base = sqlite3.connect(place, timeout=WAIT_S)
    base.text_factory = lambda raw: raw.decode("utf-8", "backslashreplace")  # of a damaged one: its checksum is wrong
    base.create_function("checksum", 1, checksum, deterministic=True)
    base.create_function("local_time", 1, local_time)
    return base


def _has_our_tables(base: sqlite3.Connection) -> bool:
    """Word for word."""
    with closing(sqlite3.connect(":memory:")) as fresh:
        fresh.executescript(_SCHEMA)
        return base.execute(_TABLES).fetchall() == fresh.execute(_TABLES).fetchall()
