"""A scan file, opened read-only, while it is written or afterwards. HDF5; its layout:

    /                 attributes: format "nlos-scan", version 1
    /header/NAME      fixed-length UTF-8 text: scan_text and bench_text (the files as given), scan_json and bench_json
                      (resolved), constants_json, devices, software, git_hash, started_utc, warnings, identity, run_json
    /plan             attributes: width_m, height_m, rows, cols, bins, bin_width_s, offset_s, stop (counts, first_bin,
                      end_bin; 0 = off), revisit_below (0 = off), within_px (only where lines may be continuous), budget
                      (total_us, step_us, batch, after_first; only where points are
                      candidates), digest
    /plan/row, col    (N,) int32, -1 off the grid       /plan/x_m, y_m, dwell_s   (N,) float64     /plan/pass (N,) int32
    /status           (1,) state, acknowledged, updated_unix_s
    /events           (1024,) unix_s, bench_s, kind, text; unused rows have an empty kind
    /samples/records  (M,) one row per sample in the order taken: written, number (into the plan), flags, taken_s,
                      live_time_s, gate_opened_s, sync_count, total_count, crc
    /samples/counts   (M, T) uint32, the histograms of the same rows; M is N, or with a budget the most that fit it

`crc` is the CRC-32 of the row's other bytes followed by its counts. `identity` is random, made with the file; copies of
a recording have the same. Every dataset lies in one piece, at its final size and place from the start, unfiltered, and
the disk space is reserved: while a scan runs only values change, never the file's structure, so a process killed at any
moment leaves a file that opens, and other programs read it all the while. A flush writes counts, then records, then
`acknowledged`: a row before that number whose CRC does not fit is damaged, one from there on was never acknowledged.
"""

import logging
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.planning.exposure import unbiased_live_s
from nlos.acquisition.recording.condition import Condition, RowState
from nlos.acquisition.recording.frames import rows_of
from nlos.acquisition.recording.layout import EVENT, EVENT_ROWS, RECORD, Event, Status, sample_crc
from nlos.acquisition.recording.open_file import ScanFile, open_scan_file
from nlos.acquisition.recording.validation import check_status, plausible_rows
from nlos.acquisition.sample import Sample
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag

__all__ = ["EVENT", "EVENT_ROWS", "MAX_CUBE_BYTES", "RECORD", "Event", "Recording", "Status", "sample_crc"]

log = logging.getLogger(__name__)

MAX_CUBE_BYTES = 8 << 30
BLOCK_ROWS = 256
LOOK_ROWS = 4096
_NOT_EXAMINED = 255


class Recording:
    """A scan file. Nothing it states about its own size is believed before it was checked."""

    def __init__(self, path: Path, file: ScanFile) -> None:
        self.path = path
        self._file = file
        self.header, self.plan = file.header, file.plan
        self._records = np.zeros(0, dtype=RECORD)
        self._given = np.zeros(0, dtype=np.bool_)
        self._states = np.zeros(0, dtype=np.uint8)
        self._firm = 0
        """Rows before this one were acknowledged when they were read, and do not change any more."""
        self._unpromised = 0
        """Rows from this one on were never acknowledged."""
        self._aside_told = (0, False)
        """Samples left aside when the log last said so."""
        self.refresh()

    @classmethod
    def open(cls, path: Path) -> "Recording":
        """Opens `path`. Raises `FileNotFoundError`, `InvalidData` where it is no complete scan file, `StorageError`
        where the disk does not let anybody know."""
        return cls(path, open_scan_file(path))

    def close(self) -> None:
        self._file.handle.close()

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def __len__(self) -> int:
        """Rows acknowledged or written so far, intact or not."""
        return len(self._records)

    @property
    def status(self) -> Status:
        """Raises `InvalidData` where it is none, `StorageError` where it cannot be read."""
        if (stored := self.stored_status()) is None:
            raise StorageError(f"{self.path}: status: the disk cannot read it. Copy the file to a sound disk.")
        state, acknowledged, _ = stored
        check_status(str(self.path), state, acknowledged, self.plan.most_samples, tuple(Status))
        return Status(state)

    @property
    def acknowledged(self) -> int:
        """Samples that the writer knew to be in the file when it last said so; 0 where the file does not say."""
        return self._promised() or 0

    def _promised(self) -> int | None:
        stored = self.stored_status()
        return stored[1] if stored is not None and stored[1] <= self.plan.most_samples else None

    def stored_status(self) -> tuple[int, int, float] | None:
        """State, acknowledged, and when that was written by the time of day; None where the disk does not give them."""
        row, given = self._file.status.read(0, 1)
        return row[0].tolist() if given[0] else None

    @property
    def on_grid(self) -> bool:
        return self.plan.positions.on_grid

    @property
    def grows_in_place(self) -> bool:
        """Whether a scan can be resumed in this very file: in those of the first versions it cannot."""
        return self._file.grows_in_place

    def has_its_name(self) -> bool:
        """Whether the open file still is the one at `path`: not after it was deleted or another took its place."""
        try:
            return os.path.samestat(os.fstat(self._file.handle.fileno()), os.stat(self.path))
        except FileNotFoundError:
            return False

    @property
    def records(self) -> npt.NDArray[Any]:
        """The rows so far (`RECORD`), without their counts; zeros where they are damaged or cannot be read."""
        return self._records

    def refresh(self) -> int:
        """Looks for rows written since; returns how many there are now."""
        promised, begin = self._promised(), min(self._firm, len(self._records))
        acknowledged = promised or 0
        records, given = [self._records[:begin]], [self._given[:begin]]
        end = max(acknowledged, begin)
        first_look = len(self._records) == 0
        room = self._file.records.count
        for first in range(begin, room, LOOK_ROWS):
            rows, there = self._file.records.read(first, min(first + LOOK_ROWS, room))
            records.append(rows)
            given.append(there)
            written = np.flatnonzero(rows["written"])
            if len(written):
                end = max(end, first + int(written[-1]) + 1)
            elif not first_look and first >= acknowledged:
                break
        self._records, self._given = np.concatenate(records)[:end], np.concatenate(given)[:end]
        fresh = np.full(end - begin, _NOT_EXAMINED, dtype=np.uint8)
        self._states, self._firm = np.concatenate([self._states[:begin], fresh]), acknowledged
        self._unpromised = end if promised is None else promised
        return len(self._records)

    def event_rows(self) -> npt.NDArray[Any]:
        """The event log as it is stored, (1024,)."""
        return self._file.events.read(0, EVENT_ROWS)[0].copy()

    def events(self) -> list[Event]:
        rows = self.event_rows()
        rows = rows[rows["kind"] != b""]
        words = ([bytes(word).decode(errors="replace") for word in rows[name]] for name in ("kind", "text"))
        moments = zip(rows["unix_s"].tolist(), rows["bench_s"].tolist(), *words, strict=True)
        return [Event(*moment) for moment in moments]

    def counts_of(self, first: int, end: int) -> npt.NDArray[np.uint32]:
        """Histograms of rows `first` up to `end`, shape (n, T). Raises `StorageError` for what cannot be read."""
        counts, given = self._file.counts.read(first, end)
        if not given.all():
            raise StorageError(f"{self.path}: row {first + int(np.argmin(given))} cannot be read from the disk")
        return counts

    def examined(
        self, first: int = 0, until: int | None = None
    ) -> Iterator[tuple[int, npt.NDArray[np.uint32], npt.NDArray[np.uint8]]]:
        """(first row, counts (n, T), `RowState` of each), block after block, from row `first` up to `until`."""
        until = len(self._records) if until is None else until
        for start in range(first, until, BLOCK_ROWS):
            end = min(start + BLOCK_ROWS, until)
            counts, given = self._file.counts.read(start, end)
            states = self._states[start:end] = self._judged(start, counts, given & self._given[start:end])
            yield start, counts, states

    def blocks(
        self, first: int = 0, until: int | None = None
    ) -> Iterator[tuple[int, npt.NDArray[np.uint32], npt.NDArray[np.bool_]]]:
        """(first row, counts (n, T), which of them are intact), block after block, from row `first` up to `until`."""
        for start, counts, states in self.examined(first, until):
            yield start, counts, states == RowState.INTACT

    def _judged(
        self, start: int, counts: npt.NDArray[np.uint32], given: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.uint8]:
        size, records = RECORD.itemsize, self._records[start : start + len(counts)]
        raw, crcs = records.tobytes(), records["crc"].tolist()
        fits = np.array([sample_crc(raw[i * size : (i + 1) * size], counts[i]) == crc for i, crc in enumerate(crcs)])
        rows = start + np.arange(len(counts))
        never = rows >= self._unpromised
        states = np.where(never, RowState.UNACKNOWLEDGED, RowState.DAMAGED).astype(np.uint8)
        states[fits & plausible_rows(records, len(self.plan))] = RowState.INTACT
        states[~given] = RowState.UNREAD
        return states

    def state_of(self, row: int) -> RowState:
        """What can be said of one row."""
        counts, given = self._file.counts.read(row, row + 1)
        return RowState(int(self._judged(row, counts, given & self._given[row : row + 1])[0]))

    def condition(self) -> Condition:
        """Which rows are what was measured. Reads those that were not read yet."""
        if (self._states == _NOT_EXAMINED).any():
            for _ in self.examined(int(np.argmax(self._states == _NOT_EXAMINED))):
                pass
        return Condition.of(self._states, self._records["flags"])

    def left_aside(self) -> int:
        """How many samples are damaged or unreadable, so unused. The log says so once, and that some are full."""
        found = self.condition()
        if (aside := (found.left_aside, bool(found.full))) > self._aside_told:
            self._aside_told = aside
            log.warning("%s: %s. `nlos verify` says more.", self.path, found.warning)
        return found.left_aside

    def intact_records(self) -> npt.NDArray[Any]:
        """The rows (`RECORD`) of all intact samples."""
        self.condition()
        intact: npt.NDArray[Any] = self._records[self._states == RowState.INTACT]
        return intact

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
        """Bench time from the scan's start to the end of the last intact sample; pauses count."""
        good = self.intact_records()
        return float((good["taken_s"] + good["live_time_s"]).max(initial=0.0))

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

    def transient(self, frames: range | None = None) -> Transient:
        """Raw counts on the wall grid, passes or these `frames` added up; time starts at the sync pulse. The exposure
        of points that were stopped at N counts is such that counts / exposure is (N - 1)/T. Raises `InvalidData` for
        free positions, which belong on a grid only after gridding, and for cubes above 8 GiB."""
        wall, axis = self.plan.wall, self.plan.axis
        if not self.on_grid:
            raise InvalidData(f"{self.path}: its points are off the grid; grid `samples()` first")
        if wall.rows * wall.cols * axis.bins * 4 > MAX_CUBE_BYTES:
            raise InvalidData(f"{self.path}: {wall.rows} x {wall.cols} x {axis.bins} counts need more than 8 GiB")
        cube = np.zeros((axis.bins, wall.rows, wall.cols), dtype=np.float32)
        exposure_s = np.zeros((wall.rows, wall.cols))
        rows = range(len(self._records)) if frames is None else rows_of(self.plan, self._records, frames)
        for start, counts, intact in self.blocks(rows.start, rows.stop):
            of = self.plan.pass_[np.minimum(self._records["number"][start : start + len(counts)], len(self.plan) - 1)]
            good = np.flatnonzero(intact if frames is None else intact & (of >= frames.start) & (of < frames.stop))
            records = self._records[start : start + len(counts)][good]
            row, col = self.plan.positions.row[records["number"]], self.plan.positions.col[records["number"]]
            live_s = unbiased_live_s(records["live_time_s"], records["flags"], self.plan.stop)
            for one_pass in np.unique(self.plan.pass_[records["number"]]):
                of_pass = self.plan.pass_[records["number"]] == one_pass
                cube[:, row[of_pass], col[of_pass]] += counts[good[of_pass]].T
                exposure_s[row[of_pass], col[of_pass]] += live_s[of_pass]
        return Transient(cube, exposure_s, wall, TimeAxis(axis.bins, axis.bin_width_s, axis.offset_s))
