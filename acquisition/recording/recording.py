"""A scan file, opened read-only, while it is written or afterwards. HDF5; its layout:

    /                 attributes: format "nlos-scan", version 1
    /header/NAME      fixed-length UTF-8 text: scan_text and bench_text (the files as given), scan_json and bench_json
                      (resolved), constants_json, devices, software, git_hash, started_utc, warnings
    /plan             attributes: width_m, height_m, rows, cols, bins, bin_width_s, offset_s, stop (counts, first_bin,
                      end_bin; 0 = off), revisit_below (0 = off), within_px (only where lines may be continuous), digest
    /plan/row, col    (N,) int32, -1 off the grid       /plan/x_m, y_m, dwell_s   (N,) float64     /plan/pass (N,) int32
    /status           (1,) state, acknowledged, updated_unix_s
    /events           (1024,) unix_s, bench_s, kind, text; unused rows have an empty kind
    /samples/records  (N,) one row per sample in the order taken: written, number (into the plan), flags, taken_s,
                      live_time_s, gate_opened_s, sync_count, total_count, crc
    /samples/counts   (N, T) uint32, the histograms of the same rows

`crc` is the CRC-32 of the row's other bytes followed by its counts. Every dataset has its final size and its place in
the file from the start, unfiltered, and the disk space is reserved: while a scan runs only values change, never the
file's structure, so a process killed at any moment leaves a file that opens. The writer is in SWMR mode: while it runs,
and after it was killed, other programs read with `swmr=True`. A row counts once its CRC fits.
"""

import ctypes
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.exposure import unbiased_live_s
from nlos.acquisition.recording.header import plain_dataset, read_header, read_plan
from nlos.acquisition.recording.plausible import check_status, plausible_rows
from nlos.acquisition.sample import Sample
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag

MAX_CUBE_BYTES = 8 << 30
EVENT_ROWS = 1024
BLOCK_ROWS = 256

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


class Recording:
    """A scan file. Nothing it states about its own size is believed before it was checked."""

    def __init__(self, path: Path, file: h5py.File) -> None:
        self.path = path
        self._file = file
        self.header = read_header(file)
        self.plan = read_plan(file)
        points, bins = len(self.plan), self.plan.axis.bins
        self._status = plain_dataset(file, "status", (1,), STATUS)
        self._events = plain_dataset(file, "events", (EVENT_ROWS,), EVENT)
        self._record_rows = plain_dataset(file, "samples/records", (points,), RECORD)
        self._count_rows = plain_dataset(file, "samples/counts", (points, bins), np.dtype("<u4"))
        self._records = np.zeros(0, dtype=RECORD)
        self.refresh()
        _ = self.status

    @classmethod
    def open(cls, path: Path) -> "Recording":
        """Opens `path`. Raises `FileNotFoundError`, and `InvalidData` where it is no complete scan file."""
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no such file")
        file = None
        try:
            file = _open_swmr(path) if _unfinished(path) else _open_finished(path)
            return cls(path, file)
        except InvalidData:
            if file is not None:
                file.close()
            raise
        except (
            OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError, AttributeError, MemoryError
        ) as error:  # fmt: skip
            if file is not None:
                file.close()
            raise InvalidData(f"{path}: not a readable scan file ({error})") from error

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def __len__(self) -> int:
        """Rows written so far, intact or not."""
        return len(self._records)

    @property
    def status(self) -> Status:
        state, acknowledged, _ = self._status[0].tolist()
        check_status(str(self.path), state, acknowledged, len(self.plan), tuple(Status))
        return Status(state)

    @property
    def acknowledged(self) -> int:
        """Samples that the writer knew to be in the file when it last said so."""
        return int(self._status[0]["acknowledged"])

    @property
    def on_grid(self) -> bool:
        return self.plan.positions.on_grid

    @property
    def records(self) -> npt.NDArray[Any]:
        """The rows written so far (`RECORD`), without their counts."""
        return self._records

    def refresh(self) -> int:
        """Looks for rows written since; returns how many there are now."""
        for dataset in (self._status, self._record_rows, self._count_rows):
            dataset.id.refresh()
        rows = self._record_rows[len(self._records) :]
        written = np.flatnonzero(rows["written"])
        if len(written):
            self._records = np.concatenate([self._records, rows[: written[-1] + 1]])
        return len(self._records)

    def events(self) -> list[Event]:
        self._events.id.refresh()
        rows = self._events[:]
        rows = rows[rows["kind"] != b""]
        words = ([bytes(word).decode(errors="replace") for word in rows[name]] for name in ("kind", "text"))
        moments = zip(rows["unix_s"].tolist(), rows["bench_s"].tolist(), *words, strict=True)
        return [Event(*moment) for moment in moments]

    def counts_of(self, first: int, end: int) -> npt.NDArray[np.uint32]:
        """Histograms of rows `first` up to `end`, shape (n, T); zeros where the disk gives nothing back."""
        for _ in range(2):
            try:
                counts: npt.NDArray[np.uint32] = self._count_rows[first:end]
                return counts
            except (OSError, RuntimeError):
                # Where this process has the file open twice, a refresh through one handle upsets the other (HDF5 2.0).
                self._count_rows.id.refresh()
        return np.zeros((end - first, self.plan.axis.bins), dtype=np.uint32)

    def blocks(self, first: int = 0) -> Iterator[tuple[int, npt.NDArray[np.uint32], npt.NDArray[np.bool_]]]:
        """(first row, counts (n, T), which of them are intact), block after block, from row `first` to the last."""
        for start in range(first, len(self._records), BLOCK_ROWS):
            end = min(start + BLOCK_ROWS, len(self._records))
            counts = self.counts_of(start, end)
            yield start, counts, self._intact(start, counts)

    def _intact(self, start: int, counts: npt.NDArray[np.uint32]) -> npt.NDArray[np.bool_]:
        size = RECORD.itemsize
        raw = self._records[start : start + len(counts)].tobytes()
        crcs = self._records["crc"][start : start + len(counts)].tolist()
        records = self._records[start : start + len(counts)]
        fits = [sample_crc(raw[i * size : (i + 1) * size], counts[i]) == crc for i, crc in enumerate(crcs)]
        return np.array(fits, dtype=np.bool_) & plausible_rows(records, len(self.plan))

    def samples(self, first: int = 0) -> Iterator[Sample]:
        """The intact samples in the order taken, from row `first`; `verify` names the others."""
        return (sample for sample in self.rows(first) if sample is not None)

    def rows(self, first: int = 0) -> Iterator[Sample | None]:
        """Every row from `first`: its sample, or None where it is not intact."""
        axis = self.plan.axis
        for start, counts, intact in self.blocks(first):
            records = self._records[start : start + len(counts)].tolist()
            for i, whole in enumerate(intact.tolist()):
                if not whole:
                    yield None
                    continue
                _, number, flags, taken_s, live_time_s, gate_opened_s, sync_count, total_count, _ = records[i]
                histogram = Histogram(
                    counts[i],
                    axis.bin_width_s,
                    axis.offset_s,
                    live_time_s,
                    sync_count,
                    total_count,
                    HistogramFlag(flags),
                    gate_opened_s,
                )
                yield Sample(self.plan[number], histogram, taken_s)

    @property
    def elapsed_s(self) -> float:
        """Bench time from the scan's start to the end of the last sample written; pauses count."""
        if not len(self._records):
            return 0.0
        last = int(np.argmax(self._records["taken_s"]))
        return float(self._records["taken_s"][last] + self._records["live_time_s"][last])

    def photons(self) -> dict[int, int]:
        """Point number -> counts in its histogram, of every intact sample."""
        found: dict[int, int] = {}
        for start, counts, intact in self.blocks():
            numbers = self._records["number"][start : start + len(counts)]
            sums = counts.sum(axis=1, dtype=np.uint64)
            found.update(zip(numbers[intact].tolist(), sums[intact].tolist(), strict=True))
        return found

    def missing(self) -> list[int]:
        """Plan numbers without an intact sample that are still to be taken, in order."""
        return self.plan.pending(self.photons())

    def transient(self) -> Transient:
        """Raw counts on the wall grid, passes added up; time starts at the sync pulse. The exposure of points that were
        stopped at N counts is such that counts / exposure is (N - 1)/T. Raises `InvalidData` for free
        positions, which belong on a grid only after gridding, and for cubes above 8 GiB."""
        wall, axis = self.plan.wall, self.plan.axis
        if not self.on_grid:
            raise InvalidData(f"{self.path}: its points are off the grid; grid `samples()` first")
        if wall.rows * wall.cols * axis.bins * 4 > MAX_CUBE_BYTES:
            raise InvalidData(f"{self.path}: {wall.rows} x {wall.cols} x {axis.bins} counts need more than 8 GiB")
        cube = np.zeros((axis.bins, wall.rows, wall.cols), dtype=np.float32)
        exposure_s = np.zeros((wall.rows, wall.cols))
        for start, counts, intact in self.blocks():
            good = np.flatnonzero(intact)
            records = self._records[start : start + len(counts)][good]
            row, col = self.plan.positions.row[records["number"]], self.plan.positions.col[records["number"]]
            live_s = unbiased_live_s(records["live_time_s"], records["flags"], self.plan.stop)
            for one_pass in np.unique(self.plan.pass_[records["number"]]):
                of_pass = self.plan.pass_[records["number"]] == one_pass
                cube[:, row[of_pass], col[of_pass]] += counts[good[of_pass]].T
                exposure_s[row[of_pass], col[of_pass]] += live_s[of_pass]
        return Transient(cube, exposure_s, wall, TimeAxis(axis.bins, axis.bin_width_s, axis.offset_s))


def _unfinished(path: Path) -> bool:
    """Whether the superblock (version 3) says that a writer in SWMR mode has, or had when it died, the file open, or
    that the file was longer once. HDF5 opens neither for plain reading."""
    with path.open("rb") as raw:
        start = raw.read(36)
    if len(start) < 36 or start[8] != 3:
        return False
    return bool(start[11] & 0x04) or int.from_bytes(start[28:36], "little") > path.stat().st_size


def _open_finished(path: Path) -> h5py.File:
    """Opens without HDF5's lock, which would keep `--resume` out; unless a handle of this process is still open from
    before the scan ended: all handles of a process must agree."""
    try:
        return h5py.File(path, "r", locking=False)
    except OSError as error:
        if "locking flag" not in str(error):
            raise
        return _open_swmr(path)


def _open_swmr(path: Path) -> h5py.File:
    """Opens for reading what another process writes. In a file whose structure never changes, metadata that fails its
    checksum is damaged: HDF5 must not read it again and again, with growing pauses, for hours."""
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_file_locking(True, True)
    set_attempts = getattr(ctypes.CDLL(h5py.h5p.__file__), "H5Pset_metadata_read_attempts", None)
    if set_attempts is not None:  # h5py has no call for it, and some platforms hide the library's own
        set_attempts(ctypes.c_int64(access.id), ctypes.c_uint(1))
    return h5py.File(h5py.h5f.open(os.fsencode(path), h5py.h5f.ACC_RDONLY | h5py.h5f.ACC_SWMR_READ, fapl=access))
