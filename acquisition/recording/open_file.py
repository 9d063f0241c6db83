"""Opens a scan file: what HDF5 has to say about it, read once and let go, and the places of its rows for as long as
the file is open."""

import io
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.file_bytes import HdfBytes
from nlos.acquisition.recording.header import has_identity, plain_dataset, read_header, read_plan
from nlos.acquisition.recording.layout import EVENT, EVENT_ROWS, RECORD, STATUS
from nlos.acquisition.recording.no_such_file import no_such_file
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.shown_to_hdf5 import shown_to_hdf5
from nlos.acquisition.recording.stored_rows import StoredRows


@dataclass(frozen=True)
class ScanFile:
    """An open scan file. The one handle on it is `handle`; whoever has this closes that."""

    handle: io.FileIO
    header: Header
    plan: ScanPlan
    status: StoredRows
    events: StoredRows
    records: StoredRows
    counts: StoredRows
    grows_in_place: bool
    """Whether a scan may be resumed in this very file: not in one that an earlier version left without an identity."""


def open_scan_file(path: Path, *, writable: bool = False) -> ScanFile:
    """Raises `FileNotFoundError`, `InvalidData` where `path` is no complete scan file, `StorageError` where the disk
    does not give its beginning back: then nobody knows what it is."""
    if not path.is_file():
        raise no_such_file(path)
    try:
        handle = io.FileIO(path, "r+" if writable else "r")
    except OSError as error:
        raise StorageError(f"{path}: cannot be opened ({error.strerror})") from error
    try:
        return _read(path, handle)
    except BaseException:
        handle.close()
        raise


def _read(path: Path, handle: io.FileIO) -> ScanFile:
    shown = HdfBytes(handle.fileno(), str(path))
    try:
        with shown_to_hdf5(shown, "r") as file:
            header, plan = read_header(file), read_plan(file, os.fstat(handle.fileno()).st_size)
            points, bins = plan.most_samples, plan.axis.bins
            found = ScanFile(
                handle,
                header,
                plan,
                StoredRows(handle, plain_dataset(file, "status", (1,), STATUS)),
                StoredRows(handle, plain_dataset(file, "events", (EVENT_ROWS,), EVENT)),
                StoredRows(handle, plain_dataset(file, "samples/records", (points,), RECORD)),
                StoredRows(handle, plain_dataset(file, "samples/counts", (points, bins), np.dtype("<u4"))),
                grows_in_place=has_identity(file),
            )
        if shown.failure is not None:
            raise shown.failure
        return found
    except (
        OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError, AttributeError, MemoryError
    ) as error:  # fmt: skip
        if shown.failure is not None:
            raise StorageError(
                f"{path}: cannot be read ({shown.failure}). Nothing was changed. Copy the file to a sound disk, and "
                "try again there."
            ) from error
        if isinstance(error, InvalidData):
            raise
        raise InvalidData(f"{path}: not a readable scan file: it is damaged, or was cut short") from error
