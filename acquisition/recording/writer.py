"""Writes a scan file (layout in `recording.py`) such that nothing that happens afterwards can take a sample away."""

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from nlos.acquisition.errors import StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.disk_refusal import GONE
from nlos.acquisition.recording.empty_file import clear, lay_out, put_in_place
from nlos.acquisition.recording.layout import EVENT_ROWS, RECORD, Status, event_row, sample_crc, status_row
from nlos.acquisition.recording.new_name import file_to_write
from nlos.acquisition.recording.open_file import open_scan_file
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.rescue import Rows, rescue
from nlos.acquisition.recording.watched_file import WatchedFile
from nlos.acquisition.recording.writer_lock import WriterLock
from nlos.acquisition.sample import Sample
from nlos.drivers.clock import Clock, SystemClock

BLOCK_SAMPLES = 64
BLOCK_S = 1.0
SYNC_S = 5.0


class RecordingWriter:
    """Appends samples in blocks of at most 64 or one second; `acknowledged` of them are in the file for good. Who
    pauses between samples for longer than the plan does flushes first."""

    def __init__(
        self,
        path: Path,
        lock: WriterLock | None = None,
        clock: Clock | None = None,
        *,
        acknowledged: int = 0,
        taken: Mapping[int, int] | None = None,
    ) -> None:
        """Takes over a file whose first `acknowledged` rows hold samples: of the points `taken`, with so many photons.
        Use `create` or `salvage.resume` instead."""
        self.path = path
        self._lock = lock
        self._clock = clock or SystemClock()
        try:
            self._file = open_scan_file(path, writable=True)
        except BaseException:
            if lock:
                lock.release()
            raise
        self.plan = self._file.plan
        self._photons = dict(taken or {})
        self._wants_all = self.plan.revisit_below is None and self.plan.budget is None
        self._next_s = float(self.plan.dwell_s.max(initial=0.0))  # how long the next sample may keep this one waiting
        self.acknowledged = self._on_disk = acknowledged
        self._watched = WatchedFile(path, self._file)
        events, _ = self._file.events.read(0, EVENT_ROWS)
        self._events = int(np.count_nonzero(events["kind"]))
        self._block = np.zeros(BLOCK_SAMPLES, dtype=RECORD)
        self._block_counts = np.zeros((BLOCK_SAMPLES, self.plan.axis.bins), dtype="<u4")
        self._filled = 0
        self._failure: Exception | None = None
        self._flushed_s = self._synced_s = self._clock.now()
        try:
            self._set_status(Status.RUNNING)
        except OSError as error:
            self._let_go()
            raise self._refused(error) from error

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
        there, path = os.path.lexists(path), file_to_write(path)  # a link to nothing is there, too
        lock = lock or WriterLock(path)
        try:
            if there and not overwrite:
                raise StorageError(f"{path}: exists. Choose another name, or use --overwrite or --resume.")
            put_in_place(lay_out(path, plan, header), path)
        except BaseException:  # an interrupt, too, leaves nothing half done
            clear(path)
            lock.release()
            raise
        return cls(path, lock, clock)

    @property
    def identity(self) -> str:
        """What no other recording is called."""
        return self._file.header.identity

    def write(self, sample: Sample) -> None:
        """Takes a sample; it is acknowledged once a flush that holds it has returned. Raises `StorageError`."""
        histogram, point = sample.histogram, sample.point
        row = self._filled
        if row == BLOCK_SAMPLES:
            self.flush()  # the last flush failed, and raises why
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
        if not self._wants_all:
            self._photons[point.number] = int(histogram.counts.sum())
        if self._filled == BLOCK_SAMPLES or self._clock.now() + self._next_s - self._flushed_s >= BLOCK_S:
            self.flush()

    @property
    def has_all(self) -> bool:
        """Whether it was given every sample that its plan asks for, and the disk took all that was written so far."""
        if self._wants_all:
            return self._failure is None and self.acknowledged + self._filled == self.plan.most_samples
        return self._failure is None and not self.plan.pending(self._photons)

    def flush(self) -> None:
        """Writes what was taken so far and acknowledges it: counts, then records, then their number, so that at no
        moment the file promises more than it holds. Raises `StorageError` where the disk refuses, and where the file is
        no longer the one that was begun."""
        if self._failure is None and self._filled:
            try:
                self._append()
            except OSError as error:
                self._failure = error
        if isinstance(self._failure, StorageError):
            raise self._failure
        if self._failure is not None:
            raise self._refused(self._failure) from self._failure
        self._flushed_s = self._clock.now()

    def log(self, kind: str, text: str, bench_s: float = 0.0, unix_s: float | None = None) -> None:
        """Adds a line to the event log. A log that is full keeps its lines and says so in the last.

        Never raises: events come while light is being shut off, which nothing may hold up. A disk that refuses an event
        is reported by the next `flush`."""
        if self._events >= EVENT_ROWS or self._file.handle.closed:
            return
        if self._events == EVENT_ROWS - 1:
            kind, text = "log_full", "further events are not kept"
        self._events += 1
        try:
            self._file.events.write(self._events - 1, event_row(kind, text, bench_s, unix_s))
        except OSError as error:
            self._failure = self._failure or error

    def finish(self, status: Status) -> None:
        """Flushes, notes how the scan ended, syncs and closes. Raises `StorageError`; where the file was deleted,
        replaced or cut, what could be saved lies beside it by then, and the error says where."""
        if self._file.handle.closed:
            return
        try:
            self.flush()
            self._set_status(status)
            os.fsync(self._file.handle.fileno())
            self._watched.check()
        except StorageError as error:
            if self._watched.lost:
                raise StorageError(f"{error} {rescue(self.path, self._file, self._pending())}") from error
            raise
        except OSError as error:
            raise self._refused(error) from error
        finally:
            self._let_go()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.finish(Status.COMPLETE if self.has_all else Status.INTERRUPTED)
            return
        try:
            self.finish(Status.FAILED)
        except StorageError as failure:
            if str(failure) != str(error):
                error.add_note(str(failure))

    def _append(self) -> None:
        first, end = self.acknowledged, self.acknowledged + self._filled
        if end > self._file.records.count:
            raise ValueError(f"{self.path}: sample {end} of a plan of {self._file.records.count}")
        self._watched.check()
        if self._lock is not None:
            self._lock.keep()
        self._file.counts.write(first, self._block_counts[: self._filled])
        self._file.records.write(first, self._block[: self._filled])
        if self._clock.now() - self._synced_s >= SYNC_S:
            os.fsync(self._file.handle.fileno())
            self._synced_s, self._on_disk = self._clock.now(), first
        self._watched.check(first, self._block[: self._filled])
        self._set_status(Status.RUNNING, end)
        self.acknowledged, self._filled = end, 0

    def _set_status(self, status: Status, acknowledged: int | None = None) -> None:
        self._file.status.write(0, status_row(status, self.acknowledged if acknowledged is None else acknowledged))

    def _pending(self) -> Rows:
        return self._block[: self._filled], self._block_counts[: self._filled]

    def _refused(self, error: Exception) -> StorageError:
        safe, more = self.acknowledged, ""
        if getattr(error, "errno", None) in GONE:  # with what the system had not yet handed on to it
            safe = self._on_disk
            more = f"Perhaps {self.acknowledged - safe} more are. " if safe < self.acknowledged else ""
        return StorageError(
            f"{self.path}: the disk refused a write ({error}). {safe} samples are safe in it. {more}"
            "Free disk space, or move the file to a sound disk, then resume with --resume."
        )

    def _let_go(self) -> None:
        with suppress(OSError):  # what a disk does not take, the write or the sync before has said
            self._file.handle.close()
        if self._lock:
            self._lock.release()
