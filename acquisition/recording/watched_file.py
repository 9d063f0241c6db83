"""Whether the file that is being written still is the one that was begun: under its name, as long, with its rows."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.file_bytes import read_at
from nlos.acquisition.recording.layout import sample_crc
from nlos.acquisition.recording.open_file import ScanFile

HEAD_BYTES = 1 << 14


class WatchedFile:
    """Looks at an open scan file from outside and from inside. `lost` says that it is no longer what was written."""

    def __init__(self, path: Path, file: ScanFile) -> None:
        self._path, self._file = path, file
        found = os.fstat(file.handle.fileno())
        self._size = found.st_size
        first_row = min(rows.place for rows in (file.status, file.events, file.records, file.counts))
        self._head_bytes = min(HEAD_BYTES, first_row)
        self._head = self._read_head()
        self._turn = 0
        self.lost = False

    def check(self, first: int = 0, records: npt.NDArray[Any] | None = None) -> None:
        """`records`: rows just written from row `first` on; they and one earlier row are read back. Raises
        `StorageError` once the file was deleted, replaced, cut or overwritten, and sets `lost`; `OSError` where it
        cannot be read."""
        if what := self._from_outside() or self._from_inside(first, records):
            self.lost = True
            raise StorageError(f"{self._path}: {what} while it was written.")

    def _from_outside(self) -> str:
        mine = os.fstat(self._file.handle.fileno())
        try:
            named = os.stat(self._path)
        except FileNotFoundError:
            return "was deleted" if mine.st_nlink == 0 else "was moved away"
        if not os.path.samestat(mine, named):
            return "was replaced by another file"
        if mine.st_size < self._size:
            return f"was cut from {self._size} to {mine.st_size} bytes"
        return ""

    def _from_inside(self, first: int, records: npt.NDArray[Any] | None) -> str:
        if self._read_head() != self._head:
            return "was overwritten"
        if records is not None:
            if self._file.records.read(first, first + len(records))[0].tobytes() != records.tobytes():
                return f"lost what was written to row {first} and those after it"
            self._turn = (self._turn + 1) % (first + len(records))
            if not self._holds(self._turn):
                return f"lost row {self._turn}"
        return ""

    def _holds(self, row: int) -> bool:
        record, there = self._file.records.read(row, row + 1)
        counts, given = self._file.counts.read(row, row + 1)
        if not (there[0] and given[0]):
            raise OSError(f"row {row} cannot be read back")
        return sample_crc(record.tobytes(), np.ascontiguousarray(counts[0])) == int(record["crc"][0])

    def _read_head(self) -> bytes:
        return read_at(self._file.handle.fileno(), self._head_bytes, 0)
