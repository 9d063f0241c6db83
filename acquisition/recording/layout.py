"""What the rows of a scan file hold (the whole layout: `recording.py`), and how far a recording can have got."""

import time
import zlib
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

EVENT_ROWS = 1024

RECORD = np.dtype(
    [
        ("written", "u1"),
        ("number", "<u4"),
        ("flags", "<u2"),
        ("taken_s", "<f8"),
        ("live_time_s", "<f8"),
        ("gate_opened_s", "<f8"),
        ("sync_count", "<u8"),
        ("total_count", "<u8"),
        ("crc", "<u4"),
    ]
)
EVENT = np.dtype([("unix_s", "<f8"), ("bench_s", "<f8"), ("kind", "S24"), ("text", "S216")])
STATUS = np.dtype([("state", "u1"), ("acknowledged", "<u8"), ("updated_unix_s", "<f8")])


class Status(IntEnum):
    """How far a recording got. A file that says `RUNNING` while nobody writes it was left by a crash."""

    RUNNING = 1
    COMPLETE = 2
    INTERRUPTED = 3
    """Ended early by a person."""
    STOPPED = 4
    """Ended early by an alarm or a limit."""
    FAILED = 5
    """Ended by an error of a device or the disk."""


@dataclass(frozen=True)
class Event:
    """One line of the event log. `bench_s`: seconds since the scan's start on the bench's clock."""

    unix_s: float
    bench_s: float
    kind: str
    text: str


def sample_crc(record: bytes, counts: npt.NDArray[np.uint32]) -> int:
    """CRC-32 of a record's bytes without its last field (the CRC itself), then of the counts."""
    return zlib.crc32(counts.data, zlib.crc32(record[: -RECORD["crc"].itemsize]))


def status_row(status: Status, acknowledged: int, unix_s: float | None = None) -> npt.NDArray[Any]:
    """What `/status` holds, (1,), as of now unless told another moment."""
    row = np.zeros(1, dtype=STATUS)
    row[0] = (status, acknowledged, time.time() if unix_s is None else unix_s)
    return row


def event_row(kind: str, text: str, bench_s: float = 0.0, unix_s: float | None = None) -> npt.NDArray[Any]:
    """A line of `/events`, (1,); words that are too long for it are cut at a letter, and what in the name of a file is
    no text is written as Python writes it."""
    row = np.zeros(1, dtype=EVENT)
    row["unix_s"], row["bench_s"] = time.time() if unix_s is None else unix_s, bench_s
    words = text.encode(errors="backslashreplace")[: EVENT["text"].itemsize]
    row["kind"], row["text"] = kind.encode()[:24], words.decode(errors="ignore").encode()
    return row
