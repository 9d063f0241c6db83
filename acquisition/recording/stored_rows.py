"""The rows of a dataset where they lie in the file, read and written past HDF5; rows that cannot be read are named."""

import io
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording.file_bytes import read_at, write_at


class StoredRows:
    """An unfiltered dataset of (N, ...), in one piece or in chunks of whole rows, whose places never change."""

    def __init__(self, handle: io.FileIO, dataset: h5py.Dataset) -> None:
        """Raises `InvalidData` where some of it has no place in the file."""
        self._handle = handle
        self.row = np.dtype((dataset.dtype, dataset.shape[1:]))
        self.count = int(dataset.shape[0])
        self._piece_rows = dataset.chunks[0] if dataset.chunks else max(self.count, 1)
        if dataset.chunks and dataset.chunks[1:] != dataset.shape[1:]:
            raise InvalidData(f"{dataset.name}: its chunks {dataset.chunks} do not hold whole rows")
        places = [dataset.id.get_offset()] if not dataset.chunks else _chunks(dataset)
        self._places = [place for place in places if place is not None]
        if len(self._places) != len(places):
            raise InvalidData(f"{dataset.name}: states {self.count} rows but does not hold them")

    @property
    def place(self) -> int:
        """Where in the file the first of it lies."""
        return min(self._places)

    def read(self, first: int, end: int) -> tuple[npt.NDArray[Any], npt.NDArray[np.bool_]]:
        """Rows `first` up to `end`, and which of them the disk gave; zeros for the others and past the file's end."""
        size = self.row.itemsize
        raw, given = bytearray((end - first) * size), np.ones(end - first, dtype=np.bool_)
        for row, rows, place in self._pieces(first, end):
            at = (row - first) * size
            try:
                part = read_at(self._handle.fileno(), rows * size, place)
                raw[at : at + len(part)] = part
            except OSError:
                self._read_singly(raw, given, row - first, rows, place)
        return np.frombuffer(raw, dtype=self.row.base).reshape(end - first, *self.row.shape), given

    def write(self, first: int, rows: npt.NDArray[Any]) -> None:
        """Puts rows in their places from `first` on. Raises `OSError`."""
        if rows.dtype != self.row.base or rows.shape[1:] != self.row.shape or first + len(rows) > self.count:
            raise ValueError(f"{rows.dtype} {rows.shape} at {first} of {self.count} rows of {self.row}")
        data, size = memoryview(rows.tobytes()), self.row.itemsize
        for row, count, place in self._pieces(first, first + len(rows)):
            at = (row - first) * size
            write_at(self._handle.fileno(), data[at : at + count * size], place)

    def _pieces(self, first: int, end: int) -> list[tuple[int, int, int]]:
        """(first row, how many, place in the file) of each piece of the rows `first` up to `end`."""
        pieces = []
        while first < end:
            piece, within = divmod(first, self._piece_rows)
            rows = min(end - first, self._piece_rows - within)
            pieces.append((first, rows, self._places[piece] + within * self.row.itemsize))
            first += rows
        return pieces

    def _read_singly(self, raw: bytearray, given: npt.NDArray[np.bool_], first: int, rows: int, place: int) -> None:
        """Around a place that cannot be read: everything else."""
        size = self.row.itemsize
        for row in range(rows):
            at = (first + row) * size
            try:
                part = read_at(self._handle.fileno(), size, place + row * size)
                raw[at : at + len(part)] = part
            except OSError:
                given[first + row] = False


def _chunks(dataset: h5py.Dataset) -> list[int | None]:
    rest = (0,) * (len(dataset.shape) - 1)
    first_rows = range(0, dataset.shape[0], dataset.chunks[0])
    return [dataset.id.get_chunk_info_by_coord((row, *rest)).byte_offset for row in first_rows]
