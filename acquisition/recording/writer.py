"""Writes a scan file (layout in `recording.py`) such that nothing that happens afterwards can take a sample away."""

import contextlib
import os
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np

from nlos.acquisition.errors import StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.header import FORMAT, VERSION, write_header, write_plan
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import EVENT, EVENT_ROWS, RECORD, STATUS, Status, sample_crc
from nlos.acquisition.recording.writer_lock import WriterLock, put_in_place
from nlos.acquisition.sample import Sample
from nlos.drivers.clock import Clock, SystemClock

BLOCK_SAMPLES = 64
BLOCK_S = 1.0
SYNC_S = 5.0
CHUNK_BYTES = 1 << 20
META_BLOCK_BYTES = 1 << 16
"""All metadata lie together at the front, where a copy that broke off still has them."""


def lay_out(path: Path, plan: ScanPlan, header: Header) -> None:
    """A complete, empty scan file at `path` (overwritten), on disk, with the space for every sample reserved.

    Raises `StorageError` where the disk has no room for the whole scan.
    """
    points, bins = len(plan), plan.axis.bins
    try:
        with h5py.File(path, "w", libver=("v110", "v110"), meta_block_size=META_BLOCK_BYTES) as file:
            file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
            write_header(file, header)
            write_plan(file, plan)
            _reserve(file, "status", (1,), STATUS, 1)
            _reserve(file, "events", (EVENT_ROWS,), EVENT, 64)
            _reserve(file, "samples/records", (points,), RECORD, min(points, 1024))
            _reserve(file, "samples/counts", (points, bins), np.dtype("<u4"), _chunk_rows(points, bins))
            file["status"][0] = (Status.RUNNING, 0, time.time())
        with path.open("r+b") as raw:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(raw.fileno(), 0, path.stat().st_size)
            os.fsync(raw.fileno())
    except (OSError, RuntimeError) as error:
        path.unlink(missing_ok=True)
        size = points * (bins * 4 + RECORD.itemsize)
        raise StorageError(
            f"{path}: cannot reserve {size / 1e6:.0f} MB for {points} points of {bins} bins ({error}). "
            "Free disk space, or choose another place with -o."
        ) from error


def _chunk_rows(points: int, bins: int) -> int:
    return max(1, min(points, BLOCK_SAMPLES, CHUNK_BYTES // (bins * 4)))


def _reserve(file: h5py.File, name: str, shape: tuple[int, ...], dtype: np.dtype[Any], chunk_rows: int) -> None:
    """A dataset whose every chunk has its place in the file now; unwritten parts read as zeros."""
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_chunk((chunk_rows, *shape[1:]))
    layout.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    links = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    links.set_create_intermediate_group(True)
    stored = h5py.h5t.py_create(dtype, logical=True)
    h5py.h5d.create(file.id, name.encode(), stored, h5py.h5s.create_simple(shape), dcpl=layout, lcpl=links)


def _open_swmr(path: Path) -> h5py.File:
    """In SWMR mode from the first moment: a file that was open for plain writing when its process died stays shut."""
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_V110, h5py.h5f.LIBVER_V110)
    access.set_file_locking(True, True)
    flags = h5py.h5f.ACC_RDWR | h5py.h5f.ACC_SWMR_WRITE
    return h5py.File(h5py.h5f.open(os.fsencode(path), flags, fapl=access))


class RecordingWriter:
    """Appends samples in blocks of at most 64 or one second; `acknowledged` of them are in the file for good."""

    def __init__(self, path: Path, plan: ScanPlan, lock: WriterLock | None = None, clock: Clock | None = None) -> None:
        """Takes over a file that `lay_out` or a salvage made. Use `create` or `salvage.resume` instead."""
        self.path = path
        self.plan = plan
        self._lock = lock
        self._clock = clock or SystemClock()
        try:
            self._file: h5py.File | None = _open_swmr(path)
        except OSError as error:
            if lock:
                lock.release()
            raise StorageError(f"{path}: cannot be opened for writing ({error})") from error
        self._records, self._counts = self._file["samples/records"], self._file["samples/counts"]
        self._status_row, self._event_rows = self._file["status"], self._file["events"]
        self.acknowledged = int(np.count_nonzero(self._records["written"]))
        self._events = int(np.count_nonzero(self._event_rows["kind"]))
        self._block = np.zeros(BLOCK_SAMPLES, dtype=RECORD)
        self._block_counts = np.zeros((BLOCK_SAMPLES, plan.axis.bins), dtype="<u4")
        self._filled = 0
        self._failure: Exception | None = None
        self._flushed_s = self._synced_s = self._clock.now()
        self._set_status(Status.RUNNING)
        self._flush()

    @classmethod
    def create(
        cls,
        path: Path,
        plan: ScanPlan,
        header: Header,
        *,
        overwrite: bool = False,
        clock: Clock | None = None,
        lock: WriterLock | None = None,
    ) -> Self:
        """A new scan file. It appears under its name only once header and plan are on disk. Raises `StorageError`
        where `path` exists and `overwrite` is not given, another process writes it, or the disk has no room."""
        lock = lock or WriterLock(path)
        try:
            if path.exists() and not overwrite:
                raise StorageError(f"{path}: exists. Choose another name, or say --overwrite or --resume.")
            fresh = path.with_name(path.name + ".new")
            lay_out(fresh, plan, header)
            put_in_place(fresh, path)
        except BaseException:
            lock.release()
            raise
        return cls(path, plan, lock, clock)

    def write(self, sample: Sample) -> None:
        """Takes a sample; it is acknowledged once a flush that holds it has returned. Raises `StorageError`."""
        histogram, point = sample.histogram, sample.point
        row = self._filled
        self._block_counts[row] = histogram.counts
        self._block[row] = (
            1,
            point.number,
            int(histogram.flags),
            sample.taken_s,
            histogram.live_time_s,
            histogram.gate_opened_s,
            histogram.sync_count,
            histogram.total_count,
            0,
        )
        self._block[row]["crc"] = sample_crc(self._block[row].tobytes(), self._block_counts[row])
        self._filled += 1
        if self._filled == BLOCK_SAMPLES or self._clock.now() - self._flushed_s >= BLOCK_S:
            self.flush()

    def flush(self) -> None:
        """Writes what was taken so far and acknowledges it. Raises `StorageError` where the disk refuses."""
        if self._failure is not None:
            raise self._refused(self._failure) from self._failure
        if self._filled:
            first, end = self.acknowledged, self.acknowledged + self._filled
            if end > len(self.plan):
                raise ValueError(f"{self.path}: sample {end} of a plan of {len(self.plan)} points")
            try:
                self._counts[first:end] = self._block_counts[: self._filled]
                self._records[first:end] = self._block[: self._filled]
            except (OSError, RuntimeError) as error:
                raise self._refused(error) from error
            self._set_status(Status.RUNNING)
            self._flush()
            self.acknowledged = end
            self._filled = 0
        self._flushed_s = self._clock.now()

    def log(self, kind: str, text: str, bench_s: float = 0.0, unix_s: float | None = None) -> None:
        """Adds a line to the event log and flushes it. A log that is full keeps its lines and says so in the last.

        Never raises: events come while light is being shut off, which nothing may hold up. A disk that refuses an event
        is reported by the next `flush`."""
        if self._events >= EVENT_ROWS or self._file is None:
            return
        if self._events == EVENT_ROWS - 1:
            kind, text = "log_full", "further events are not kept"
        line = np.zeros((), dtype=EVENT)
        line["unix_s"], line["bench_s"] = time.time() if unix_s is None else unix_s, bench_s
        line["kind"], line["text"] = kind.encode()[:24], _shortened(text, EVENT["text"].itemsize)
        try:
            self._event_rows[self._events] = line
            self._flush()
        except (OSError, RuntimeError) as error:
            self._failure = error
        self._events += 1

    def finish(self, status: Status) -> None:
        """Flushes, notes how the scan ended, syncs and closes. Raises `StorageError`."""
        if self._file is None:
            return
        try:
            self.flush()
            self._set_status(status)
            self._flush(sync=True)
            self._file.close()
        except (OSError, RuntimeError) as error:
            raise self._refused(error) from error
        finally:
            self._give_up()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None or self._file is None:
            self.finish(Status.COMPLETE if self.acknowledged + self._filled == len(self.plan) else Status.INTERRUPTED)
            return
        try:
            self.finish(Status.FAILED)
        except StorageError:
            self._give_up()

    def _set_status(self, status: Status) -> None:
        """What the file says about itself trails by one flush, so that it never promises more than it holds."""
        self._status_row[0] = (status, self.acknowledged, time.time())

    def _flush(self, sync: bool = False) -> None:
        if self._file is None:
            raise StorageError(f"{self.path}: is closed")
        try:
            self._file.flush()
            if sync or self._clock.now() - self._synced_s >= SYNC_S:
                os.fsync(self._file.id.get_vfd_handle())
                self._synced_s = self._clock.now()
        except (OSError, RuntimeError) as error:
            raise self._refused(error) from error

    def _refused(self, error: Exception) -> StorageError:
        return StorageError(
            f"{self.path}: the disk refused a write ({error}). {self.acknowledged} samples are safe. "
            "Free disk space, then go on with --resume."
        )

    def _give_up(self) -> None:
        """Lets go of file and lock, without another word to the disk where it already refused."""
        file, self._file = self._file, None
        if file is not None and file.id.valid:
            with contextlib.suppress(OSError, RuntimeError):
                file.close()
        if self._lock:
            self._lock.release()


def _shortened(text: str, size: int) -> bytes:
    return text.encode("utf-8")[:size].decode("utf-8", errors="ignore").encode("utf-8")
