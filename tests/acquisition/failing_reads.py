"""Opens a recording again and again, each time in a child for which other reads fail, and prints how each child ended.

A program of its own: what C libraries do last is part of a child's end, and a test run has many of them, with threads
that no child of it has. It prints {"for_good": {place: code}, "once": [code], "sound": code} as JSON.
"""

import ctypes
import errno
import json
import multiprocessing
import os
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.file_bytes import READ_TRIES
from nlos.acquisition.recording.open_file import open_scan_file

REFUSED, OPENED, ELSE = 3, 4, 5


def outcome(path: Path, fails: Callable[[int], bool]) -> int | None:
    """How a process ends that opens the file where a read at some places fails."""
    real = os.pread

    def pread(fd: int, size: int, place: int) -> bytes:
        if fails(place):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return real(fd, size, place)

    def child() -> None:
        os.pread, code = pread, ELSE
        try:
            open_scan_file(path).handle.close()
            code = OPENED
        except StorageError as error:
            code = REFUSED if "cannot be read" in str(error) else ELSE
        finally:
            ctypes.CDLL(None).exit(code)  # as a process ends: with what the C libraries do last

    process = multiprocessing.get_context("fork").Process(target=child)
    process.start()
    process.join(240)
    process.kill()
    process.join()
    return process.exitcode


def places_read(path: Path) -> list[int]:
    """Where the file is read while it is opened, in order."""
    places, real = list[int](), os.pread

    def pread(fd: int, size: int, place: int) -> bytes:
        places.append(place)
        return real(fd, size, place)

    os.pread = pread
    open_scan_file(path).handle.close()
    os.pread = real
    return places


def main(path: Path) -> None:
    places = places_read(path)
    for_good = {bad: outcome(path, lambda place, bad=bad: place == bad) for bad in sorted(set(places))}
    once = []
    for first in range(len(places)):
        asked = count()
        once.append(outcome(path, lambda _, first=first, asked=asked: first <= next(asked) < first + READ_TRIES))
    print(json.dumps({"for_good": for_good, "once": once, "sound": outcome(path, lambda place: False)}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
