"""Reads files from outside in a child process: whatever a damaged file does to a parser, it does it over there.

The child has a memory limit and a deadline; arrays come back as .npy files in a folder of the parent's, never pickled.
What this process then reads itself - its own recordings, results, constants - a child has read to the end before.
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict
from multiprocessing.spawn import get_executable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.imported import PLAIN_FIELDS, FreePoints, ImportedScan
from nlos.acquisition.importers.magic import check_is_file
from nlos.acquisition.importers.unchanged import unchanged
from nlos.acquisition.response import from_json
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid

DEADLINE_S, BYTES_PER_S = 30.0, 10e6
"""A file gets so long, and longer the larger it is."""
MEMORY_BYTES = 24 << 30
"""Address space of the child: three times the largest scan that is read, and what Python and its libraries map."""

START_DEADLINE_S = 120.0
"""A start takes a second; of a machine that is short of memory, or of a Python on a slow share, many."""

_NOT_STARTED = "no process could be started to read files in"
_MAKE_ROOM = "Nothing is known of the file. End other programs, and call again."
_CHILD = "nlos.acquisition.importers.isolated_child"


class NoScan(InvalidData):
    """A file that can be read but holds no scan; `contents` is what it holds, by name."""

    def __init__(self, message: str, contents: Mapping[str, object]) -> None:
        self.contents = contents
        super().__init__(message)


class ReaderDied(InvalidData):
    """The child crashed on a file, or ran out of time or memory: whatever the file is, nobody should read it here."""


class ReaderNotStarted(StorageError):
    """There is no process to read files in. It says nothing about any file."""


class IsolatedReader:
    """A child process that reads one file after another; it is restarted after a crash.

    `memory_bytes` limits the child's address space where the operating system can (not on Windows); `deadline_s` the
    time for one file, `DEADLINE_S` and what its size takes unless given.
    """

    def __init__(self, memory_bytes: int = MEMORY_BYTES, deadline_s: float | None = None) -> None:
        self._memory_bytes, self._deadline_s = memory_bytes, deadline_s
        self._child: subprocess.Popen[str] | None = None

    def read(self, path: Path, given: Given = NOTHING, *, describe: bool = False) -> ImportedScan:
        """As `formats.read_any`. Raises `InvalidData` also where the reader crashed or ran out of time or memory,
        `StorageError` where the file changes meanwhile; with `describe`, `NoScan` for one that holds something else."""
        with tempfile.TemporaryDirectory(prefix="nlos-import-") as folder, unchanged(path):
            answer = self._ask(path, {"given": asdict(given), "folder": folder, "describe": describe})
            return _load(Path(folder), answer)

    def check(self, path: Path, reader: str) -> None:
        """Has the child run `reader` (`package.module:function`, given the path) to its end. Raises `InvalidData`
        where it refuses, crashes, or runs out of time or memory: then nobody else should read that file."""
        self._ask(path, {"reader": reader})

    def ask(self, path: Path, reader: str) -> dict[str, Any]:
        """What `reader` returns of the file, a dictionary of plain JSON values. Raises as `check` does."""
        return dict(self._ask(path, {"reader": reader})["found"])

    def close(self) -> None:
        """Ends the child. May be called twice."""
        child, self._child = self._child, None
        if child is not None:
            child.kill()
            child.wait()
            for pipe in (child.stdin, child.stdout):
                if pipe is not None:
                    with contextlib.suppress(BrokenPipeError):  # a request that the child never read
                        pipe.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _ask(self, path: Path, wanted: dict[str, object]) -> dict[str, Any]:
        """The child's answer. Raises `InvalidData` where it is an error, or none came."""
        check_is_file(path)
        deadline_s = self._deadline_s
        if deadline_s is None:
            deadline_s = DEADLINE_S + path.stat().st_size / BYTES_PER_S
        asked = {"reader": None, "describe": False, "deadline_s": deadline_s} | wanted
        line = self._exchange(json.dumps(asked | {"path": str(path.absolute()), "shown": str(path)}), deadline_s)
        if not line:
            code = self._child.wait() if self._child is not None else 0
            self.close()
            late = f" within {deadline_s:.0f} s" if code in (-14, -9) else ""
            raise ReaderDied(
                f"{path}: the reader did not survive this file{late}; it is damaged, or not what it says. "
                "Copy it again from where it was made."
            )
        answer: dict[str, Any] = json.loads(line)
        if "storage" in answer:
            raise StorageError(str(answer["storage"]))
        if "error" in answer:
            if answer.get("contents"):
                raise NoScan(str(answer["error"]), answer["contents"])
            raise InvalidData(str(answer["error"]))
        return answer

    def _exchange(self, request: str, deadline_s: float) -> str:
        """One line to the child and one back; empty where it died or had to be killed after the deadline."""
        if self._child is None or self._child.poll() is not None:
            self._start()
        child = self._child
        assert child is not None
        assert child.stdin is not None
        assert child.stdout is not None
        timer = threading.Timer(deadline_s + 10.0, child.kill)  # the child ends itself, but where it has no timer
        timer.daemon = True  # a Ctrl-C that comes right here must not wait for it
        try:
            timer.start()
            child.stdin.write(request + "\n")
            child.stdin.flush()
            return child.stdout.readline()
        except BrokenPipeError:
            return ""
        finally:
            timer.cancel()

    def _start(self) -> None:
        """Raises `ReaderNotStarted` where the child does not come as far as its first request."""
        self.close()
        python = _interpreter()
        try:
            self._child = subprocess.Popen(
                [python, "-P", "-m", _CHILD, str(self._memory_bytes)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                encoding="utf-8",
            )
        except OSError as error:
            raise ReaderNotStarted(f"{_NOT_STARTED} ({error.strerror}). {_MAKE_ROOM}") from error
        assert self._child.stdout is not None
        timer = threading.Timer(START_DEADLINE_S, self._child.kill)
        timer.daemon = True
        try:
            timer.start()
            ready = self._child.stdout.readline()
        finally:
            timer.cancel()
        if not ready:
            code = self._child.wait()
            self.close()
            raise ReaderNotStarted(f"{_NOT_STARTED} (it ended with {code}). {_MAKE_ROOM}")


def _interpreter() -> str:
    """The Python of child processes. Raises `ReaderNotStarted` in a program that is its own (as PyInstaller makes
    them): started as a child, it would do all that it does once more, scans among it."""
    if not getattr(sys, "frozen", False):
        return sys.executable
    named = os.fsdecode(get_executable() or "")
    if named in ("", sys.executable):
        raise ReaderNotStarted(
            f"{_NOT_STARTED}: this program ({Path(sys.executable).name}) brings its own Python. Name one that has nlos "
            "by multiprocessing.set_executable, before anything is read."
        )
    return named


def read_isolated(path: Path, given: Given = NOTHING, *, describe: bool = False) -> ImportedScan:
    """One file, read by a child process of its own, or by that of `one_reader`."""
    with one_reader() as reader:
        return reader.read(path, given, describe=describe)


_shared: ContextVar[IsolatedReader | None] = ContextVar("_shared", default=None)


@contextmanager
def one_reader() -> Iterator[IsolatedReader]:
    """Inside, all files are read by the same child: for whoever reads many."""
    if (outer := _shared.get()) is not None:
        yield outer
        return
    with IsolatedReader() as reader, reading_by(reader):
        yield reader


@contextmanager
def reading_by(reader: IsolatedReader) -> Iterator[None]:
    """Inside, all files are read by this reader, which lives on: for whoever comes back with the next file."""
    token = _shared.set(reader)
    try:
        yield
    finally:
        _shared.reset(token)


_sound: set[tuple[str, int, int, int, int]] = set()


def check_isolated(path: Path, reader: str) -> None:
    """`IsolatedReader.check` in a child of its own; once for a file that has not changed since."""
    check_is_file(path)
    now = path.stat()
    seen = (reader, now.st_dev, now.st_ino, now.st_size, now.st_mtime_ns)
    if seen not in _sound:
        with one_reader() as child:
            child.check(path, reader)
        _sound.add(seen)


def _load(folder: Path, answer: dict[str, Any]) -> ImportedScan:
    """What the child left in `folder`."""
    arrays = {path.stem: np.load(path, allow_pickle=False) for path in folder.glob("*.npy")}
    wall, time = WallGrid(**answer["wall"]), TimeAxis(**answer["time"])
    counts, exposure_s = arrays["counts"], arrays["exposure_s"]
    places_m = arrays.get("places_m")
    held = (
        Transient(counts, exposure_s, wall, time)
        if places_m is None
        else FreePoints(counts, exposure_s, places_m[0], places_m[1], wall, time)
    )
    fields = {key: answer[key] for key in PLAIN_FIELDS}
    return ImportedScan(
        held,
        time_offset_bins=arrays.get("time_offset_bins"),
        response=from_json(answer["response"]),
        notes=tuple(map(str, answer["notes"])),
        **fields,
    )
