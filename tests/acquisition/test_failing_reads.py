"""A disk that gives one part of a recording and not another: it cannot be read, which is said; the process lives."""

import ctypes
import errno
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from nlos.acquisition.errors import StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.file_bytes import READ_TRIES
from nlos.acquisition.recording.open_file import open_scan_file
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Status
from nlos.acquisition.recording.writer import RecordingWriter

FORK = multiprocessing.get_context("fork")
REFUSED, OPENED, ELSE = 3, 4, 5
pytestmark = pytest.mark.skipif(not hasattr(os, "pread"), reason="it is pread that fails here")
_pread: Any = getattr(os, "pread", None)


def outcome(path: Path, fails: Callable[[int], bool]) -> int | None:
    """How a process ends that opens the file where a read at some places fails."""

    def pread(fd: int, size: int, place: int) -> bytes:
        if fails(place):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return bytes(_pread(fd, size, place))

    def child() -> None:
        os.pread, code = pread, ELSE
        try:
            open_scan_file(path).handle.close()
            code = OPENED
        except StorageError as error:
            code = REFUSED if "cannot be read" in str(error) else ELSE
        finally:
            ctypes.CDLL(None).exit(code)  # as a process ends: with what the C libraries do last

    process = FORK.Process(target=child)
    process.start()
    process.join(30)
    process.kill()
    process.join()
    return process.exitcode


def test_a_recording_of_which_any_one_read_fails_is_refused_and_the_process_lives(
    run_path: Path, small_plan: Callable[..., ScanPlan], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For good, or until it is asked for again."""
    RecordingWriter.create(run_path, small_plan(4, 4), Header()).finish(Status.INTERRUPTED)
    places: list[int] = []
    with monkeypatch.context() as patch:
        patch.setattr(os, "pread", lambda fd, size, place: places.append(place) or _pread(fd, size, place))
        open_scan_file(run_path).handle.close()
    for_good = {bad: outcome(run_path, lambda place, bad=bad: place == bad) for bad in set(places)}
    assert set(for_good.values()) == {REFUSED}, for_good
    for first in range(len(places)):
        asked = count()
        once = outcome(run_path, lambda _, first=first, asked=asked: first <= next(asked) < first + READ_TRIES)
        assert once == REFUSED, f"read {first} of {len(places)}"
    assert outcome(run_path, lambda place: False) == OPENED


KEPT = """\
import itertools, os, sys
from pathlib import Path
from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.open_file import open_scan_file

reads, pread, good = itertools.count(), os.pread, int(sys.argv[2])

def fails(fd, size, place):
    if next(reads) >= good:
        raise OSError(5, "Input/output error")
    return pread(fd, size, place)

os.pread = fails
try:
    open_scan_file(Path(sys.argv[1]))
except StorageError as error:
    sys.kept = error
"""


@pytest.mark.parametrize("good", [1, 3])
def test_an_error_that_is_kept_until_the_process_ends_does_not_crash_it(
    run_path: Path, small_plan: Callable[..., ScanPlan], good: int
) -> None:
    RecordingWriter.create(run_path, small_plan(4, 4), Header()).finish(Status.INTERRUPTED)
    ended = subprocess.run(
        [sys.executable, "-c", KEPT, run_path, str(good)], capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, ended.stderr) == (0, "")
