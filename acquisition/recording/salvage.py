"""What a crash left: recovered into a new file, or resumed."""

import math
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.importers.isolated import ReaderDied
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.condition import listed
from nlos.acquisition.recording.empty_file import clear, keep_as, put_in_place
from nlos.acquisition.recording.frames import ended_plan
from nlos.acquisition.recording.layout import Status
from nlos.acquisition.recording.new_name import behind_link, file_to_write
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.read_by_child import check_recording, open_checked
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.rescue import copied, written_unix_s
from nlos.acquisition.recording.same_scan import check_same_scan
from nlos.acquisition.recording.validation import LONGEST_S
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.recording.writer_lock import WriterLock, clear_left_lock, is_locked
from nlos.drivers.clock import Clock

UNCUT = (
    "Its samples are safe. `nlos recover {path} -o NEW.h5`, on a disk with room for them, makes the recording of its "
    "frames; `--resume` resumes the film."
)
"""Of the recording of a film that was stopped and could not be ended."""


def recover(path: Path, target: Path, *, overwrite: bool = False) -> int:
    """Copies header, plan, events and every intact sample of `path` into a new scan file `target`; returns how many
    samples. Raises `InvalidData` where `path` has no complete header, `StorageError` where `target` exists."""
    if os.path.lexists(target) and not overwrite:  # a link to nothing, too
        raise StorageError(f"{target}: exists. Choose another name, or use --overwrite.")
    target = file_to_write(target)
    lock = WriterLock(target)
    try:
        with Recording.open(path) as recording:
            if target.exists() and path.samefile(target):
                raise StorageError(f"{target}: is the recording itself. Choose another name.")
            whose = recording.plan if is_locked(path) else ended_plan(recording.plan, recording.intact_records())
            fresh, samples = _copied(recording, target, whose)
        put_in_place(fresh, target)
        _clear_beside(path)
        return samples
    except BaseException:  # an interrupt, too, leaves nothing half done
        clear(target)
        raise
    finally:
        lock.release()


@dataclass(frozen=True)
class EndedFilm:
    """What became of a film until it is stopped. `whole`: up to its last point it has all."""

    plan: ScanPlan
    whole: bool

    def said(self) -> str:
        """How many frames it has."""
        points = np.bincount(self.plan.pass_)
        part = "" if points[-1] == self.plan.frame_points[-1] else " and a part of one"
        whole = len(points) - bool(part)
        return f"{whole} frame{'' if whole == 1 else 's'}{part}, {len(self.plan)} points"


def end_film(path: Path) -> EndedFilm | None:
    """A film until it is stopped was: its recording becomes one of the frames that it has. None, and nothing is
    changed, where less than all points of the wall came once. Raises `StorageError`."""
    path = behind_link(path)
    lock = WriterLock(path)
    try:
        with Recording.open(path) as recording:
            records = recording.intact_records()
            if len(records) < recording.plan.first_round:
                return None
            plan = ended_plan(recording.plan, records)
            fresh, samples = _copied(recording, path, plan)
        put_in_place(fresh, path)
        return EndedFilm(plan, samples == len(plan))
    except StorageError as error:
        clear(path)
        raise StorageError(
            f"{path}: was not cut to the frames of its film, which takes their place on the disk once more ({error}). "
            f"{UNCUT.format(path=path)}"
        ) from error
    except BaseException:
        clear(path)
        raise
    finally:
        lock.release()


def _clear_beside(path: Path) -> None:
    """What a killed process left half done beside it, unless somebody writes it."""
    path = behind_link(path)
    with suppress(StorageError):
        lock = WriterLock(path)
        try:
            clear(path)
        finally:
            lock.release()


def _copied(recording: Recording, target: Path, plan: ScanPlan) -> tuple[Path, int]:
    status = Status.INTERRUPTED if plan.pending(recording.photons()) else Status.COMPLETE
    warning = recording.condition().warning
    kind, note = "salvaged", f"copied from {recording.path.name}"
    if recording.plan.until_stopped != plan.until_stopped:
        kind, note = "film", "resumed" if plan.until_stopped else f"ended in frame {plan.frames - 1}"
    return copied(recording, target, status, (kind, f"{note}{warning and f'; {warning}'}"), plan=plan)


@dataclass(frozen=True)
class Resumed:
    """Where a scan resumes: `writer` is None where nothing is left to take; `taken` and `elapsed_s` are for `scan`."""

    writer: RecordingWriter | None
    taken: Mapping[int, int]
    elapsed_s: float
    """Bench time since the scan's start, the time in which nobody was scanning included."""
    away_s: float = 0.0
    """How much of it that was."""
    lit_s: float = 0.0
    """When its first point was lit."""
    kept: Path | None = None
    """What lay there before, unreadable or with damaged rows, under a name of its own."""


def resume(
    path: Path, plan: ScanPlan, header: Header, *, clock: Clock | None = None, same_run: bool = False
) -> Resumed:
    """Continues where the recording at `path` ends; on a complete one there is nothing to do but to say so in it.

    Without a file, or on one without a complete header, a new recording is begun; what lay there is kept as
    `RUN.h5.unreadable`. One with damaged rows is copied without them, and kept as `RUN.h5.damaged`. Raises
    `ResumeRefused` where plan, constants or devices are not those of the recording, or with `same_run` its identity;
    `StorageError` where another process writes it, or where some of it cannot be read: then nothing is changed.
    """
    path = file_to_write(path)
    lock = WriterLock(path)
    kept = None
    try:
        if path.exists():
            try:
                check_recording(path)
                recording = Recording.open(path)
            except ReaderDied:
                raise
            except InvalidData:
                kept = keep_as(path, path, "unreadable")
                path.unlink()
            else:
                with recording:
                    check_same_scan(recording, plan, header, same_run)
                    return _resumed(recording, plan, lock, clock)
        return Resumed(RecordingWriter.create(path, plan, header, clock=clock, lock=lock), {}, 0.0, kept=kept)
    except BaseException:
        clear(path)
        lock.release()
        raise


def settle(path: Path, plan: ScanPlan) -> bool:
    """Whether the recording at `path` holds everything that `plan` asks for; then it says so itself from now on, also
    where it was killed after its last sample. Raises as `resume` does."""
    path = behind_link(path)
    try:
        with open_checked(path) as recording:
            if recording.plan != plan or recording.missing():
                return False
            if recording.status is not Status.COMPLETE:
                lock = WriterLock(path)
                try:
                    _resumed(recording, plan, lock, None)
                except BaseException:
                    lock.release()
                    raise
            clear_left_lock(path)
            return True
    except (FileNotFoundError, InvalidData):
        return False


def _resumed(recording: Recording, plan: ScanPlan, lock: WriterLock, clock: Clock | None) -> Resumed:
    path, condition = recording.path, recording.condition()
    if condition.unread:
        raise StorageError(
            f"{path}: rows {listed(condition.unread)} cannot be read from the disk, so nobody knows what is missing. "
            f"Nothing was changed. Copy the file to a sound disk; or `nlos recover {path} -o NEW.h5` and resume that."
        )
    taken = recording.photons()
    last_s, away = _since_the_last(recording) if taken else (0.0, 0.0)
    away_s, before_s = away or 0.0, _away_before(recording)
    lit_s = float(recording.intact_records()["taken_s"].min(initial=last_s))
    rows, done = condition.intact, not plan.pending(taken)
    if done:
        if recording.status is Status.COMPLETE:
            lock.release()
        else:  # killed after its last sample
            RecordingWriter(path, lock, clock, acknowledged=rows).finish(Status.COMPLETE)
        return Resumed(None, taken, last_s)
    as_it_is = condition.in_one_piece and len(taken) == rows and recording.grows_in_place and recording.plan == plan
    kept = None
    if condition.damaged or not as_it_is:
        fresh, rows = _copied(recording, path, plan)
        if condition.damaged:
            kept = keep_as(path, path, "damaged")
        put_in_place(fresh, path)
    writer = RecordingWriter(path, lock, clock, acknowledged=rows, taken=taken)
    if taken:
        long = "nobody knows how long: the computer's clock was set" if away is None else f"{away_s:.1f} s"
        writer.log("resumed", f"{long} after the last of it", last_s + away_s)
    return Resumed(writer, taken, last_s + away_s, before_s + away_s, lit_s, kept)


def _away_before(recording: Recording) -> float:
    """How long nobody was scanning before each time that it was resumed, in all."""
    records, away_s = recording.intact_records(), 0.0
    events = [event for event in recording.events() if math.isfinite(event.bench_s)]
    for number, event in enumerate(events):
        if event.kind == "resumed":
            ended_s = (records["taken_s"] + records["live_time_s"])[records["taken_s"] < event.bench_s]
            away_s += event.bench_s - max((float(ended_s.max(initial=0.0)), *(e.bench_s for e in events[:number])))
    return away_s


def _since_the_last(recording: Recording) -> tuple[float, float | None]:
    """The latest bench time that it tells of, samples and events, and how long ago that was by the time of day: None
    where that is yet to come, or longer ago than any scan takes. A computer whose battery is empty begins in 1970."""
    events = [event for event in recording.events() if 0 < event.bench_s < math.inf and event.unix_s < math.inf]
    bench_s = max((recording.elapsed_s, *(event.bench_s for event in events)))
    unix_s = max((written_unix_s(recording) or 0.0, *(event.unix_s for event in events)))
    away_s = time.time() - unix_s
    return bench_s, away_s if unix_s > 0 and 0 <= away_s <= LONGEST_S / 2 - bench_s else None
