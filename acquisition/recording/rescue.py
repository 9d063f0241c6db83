"""Samples brought to safety: copied as they are into a new scan file, which is read back before it is relied on."""

import itertools
import math
import os
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.condition import RowState
from nlos.acquisition.recording.empty_file import keep_as, lay_out
from nlos.acquisition.recording.layout import Status, event_row, status_row
from nlos.acquisition.recording.open_file import ScanFile, open_scan_file
from nlos.acquisition.recording.recording import Recording

Rows = tuple[npt.NDArray[Any], npt.NDArray[np.uint32]]
"""Records (n,) and their counts (n, T)."""


def copied(
    recording: Recording,
    target: Path,
    status: Status,
    event: tuple[str, str],
    more: Iterable[Rows] = (),
    plan: ScanPlan | None = None,
) -> tuple[Path, int]:
    """Copies every intact sample of `recording`, and `more`, into a new scan file beside `target`; returns its path and
    how many samples it holds, each of them read back. `event`, its kind and its text, goes into the log. `plan`: longer
    or shorter than the recording's, with the same points. For whoever holds the target's lock. Raises `StorageError`.
    """
    fresh = lay_out(target, plan or recording.plan, recording.header)
    try:
        kept: dict[int, int] = {}
        file = open_scan_file(fresh, writable=True)
        with file.handle:
            for records, counts in itertools.chain(_intact(recording), more):
                _append(file, kept, records, counts)
            log = recording.event_rows()
            free = np.flatnonzero(log["kind"] == b"")[:1]
            log[free] = event_row(event[0], f"{event[1]}: {len(kept)} samples", unix_s=time.time())
            file.events.write(0, log)
            file.status.write(0, status_row(status, len(kept), written_unix_s(recording)))
            os.fsync(file.handle.fileno())
        _prove(fresh, kept)
    except OSError as error:
        fresh.unlink(missing_ok=True)
        if isinstance(error, StorageError):
            raise
        raise StorageError(f"{target}: the samples could not be copied ({error}). Nothing was changed.") from error
    return fresh, len(kept)


def written_unix_s(recording: Recording) -> float | None:
    """When, by the time of day, it was last written to; None where it does not say."""
    _, _, found = recording.stored_status() or (0, 0, 0.0)
    return found if 0 < found < math.inf else None


def rescue(path: Path, file: ScanFile, pending: Rows) -> str:
    """What is still to be had of a scan file that lost its name or its end, and the samples not yet in it, into
    `RUN.h5.rescued`, or where that cannot be into the system's folder for temporary files; says what became of it."""
    failures = []
    for place in (path.parent, None):
        try:
            folder = Path(tempfile.gettempdir()) if place is None else place  # there may be none that is usable
            target = folder / path.name
            # Nobody else comes to think of this name, and lying there for a moment under another it needs no lock.
            fresh, samples = copied(
                Recording(path, file),
                folder / f"{path.name}.rescued",
                Status.FAILED,
                ("salvaged", "rescued"),
                [pending],
            )
            kept = keep_as(fresh, target, "rescued")
            fresh.unlink()
        except OSError as error:
            failures.append(str(error))
        else:
            return f"{samples} samples are safe in {kept}: rename it to {path.name}, then resume with --resume."
    return f"Its samples could not be saved elsewhere: {'; '.join(failures)}"


def _intact(recording: Recording) -> Iterator[Rows]:
    for start, counts, states in recording.examined():
        good = states == RowState.INTACT
        yield recording.records[start : start + len(counts)][good], counts[good]


def _append(file: ScanFile, kept: dict[int, int], records: npt.NDArray[Any], counts: npt.NDArray[np.uint32]) -> None:
    """Writes the rows of points that are not in `kept` yet, and adds them: point number -> CRC."""
    before = len(kept)
    new: list[int] = []
    for row, (number, crc) in enumerate(zip(records["number"].tolist(), records["crc"].tolist(), strict=True)):
        if kept.setdefault(number, crc) == crc and len(kept) == before + len(new) + 1:
            new.append(row)
    file.counts.write(before, np.ascontiguousarray(counts[new]))
    file.records.write(before, records[new])


def _prove(fresh: Path, kept: dict[int, int]) -> None:
    """Raises `StorageError` unless the file holds these samples, read back from the disk."""
    with Recording.open(fresh) as copy:
        condition = copy.condition()
        found = dict(zip(copy.records["number"].tolist(), copy.records["crc"].tolist(), strict=True))
    if condition.left_aside or found != kept:
        raise StorageError(f"{fresh}: what was copied is not what is there. Nothing was changed. Try another disk.")
