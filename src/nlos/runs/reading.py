"""What the index of runs keeps of each recording, read by children side by side."""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.importers.isolated import IsolatedReader, ReaderNotStarted
from nlos.acquisition.importers.magic import is_recording
from nlos.runs.database import Row
from nlos.runs.query import OTHER, UNREADABLE, utc_time

_READER = "nlos.acquisition.recording.summary:summarise"
_BATCH = 500
_READERS, _WORTH_A_READER = 4, 50
"""Children that read side by side, each worth its start from so many files on."""
Stamp = tuple[int, int, int]
"""Size, time of change, inode."""


def read_in_batches(folder: Path, fresh: Mapping[str, Stamp]) -> Iterator[list[Row]]:
    """A row for each of these files, named relative to `folder`, some hundred at a time."""
    paths = list(fresh)
    many = min(_READERS, os.cpu_count() or 1, 1 + len(paths) // _WORTH_A_READER)
    with ExitStack() as stack:
        readers = [stack.enter_context(IsolatedReader()) for _ in range(many)]
        threads = stack.enter_context(ThreadPoolExecutor(many, thread_name_prefix="runs"))
        for first in range(0, len(paths), _BATCH):
            batch = paths[first : first + _BATCH]
            parts = [threads.submit(_rows, reader, folder, batch[i::many], fresh) for i, reader in enumerate(readers)]
            yield [row for part in parts for row in part.result()]


def _rows(reader: IsolatedReader, folder: Path, paths: Sequence[str], fresh: Mapping[str, Stamp]) -> list[Row]:
    return [_row(reader, folder, path, fresh[path]) for path in paths]


def _row(reader: IsolatedReader, folder: Path, path: str, stamp: Stamp) -> Row:
    full, kind = folder / path, "recording"
    try:
        if not is_recording(full):
            raise InvalidData("another HDF5 file")
        said = reader.ask(full, _READER)
    except ReaderNotStarted:
        raise  # of this computer, and no word about the file
    except (InvalidData, StorageError, OSError) as error:
        kind = UNREADABLE if _may_be_one(full) else OTHER
        said = {"status": UNREADABLE, "trouble": str(error)}
    started = utc_time(str(said.get("started_utc", "")))
    told = [str(said.get(name, "")) for name in ("sample", "operator", "note")]
    tags, bench = " ".join(said.get("tags", [])), str(said.get("bench", ""))
    words = " ".join([path, *told, tags, bench, str(said.get("status")), str(said.get("pattern", "")),
                      *said.get("devices", [])]).casefold()  # fmt: skip
    row = (
        path, *stamp, kind, started, said.get("status"), said.get("points"), said.get("planned"),
        said.get("photons"), said.get("live_s"), *told, tags, bench, words,
    )  # fmt: skip
    return row, json.dumps(said)


def _may_be_one(path: Path) -> bool:
    """Whether a file that cannot be read was meant to be a recording."""
    try:
        return is_recording(path)
    except (OSError, InvalidData):
        return True
