"""What a crash left: verified, recovered into a new file, or gone on with."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.checked import check_recording
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter, lay_out
from nlos.acquisition.recording.writer_lock import WriterLock, put_in_place
from nlos.drivers.clock import Clock
from nlos.drivers.identity import DeviceIdentity


class ResumeRefused(InvalidData):
    """The recording was made with another plan, other constants or other devices."""


@dataclass(frozen=True)
class Verification:
    """What `verify` found: rows written, row numbers that fail their CRC, plan numbers stored twice or not at all."""

    status: Status
    planned: int
    written: int
    corrupt: tuple[int, ...]
    repeated: tuple[int, ...]
    missing: tuple[int, ...]

    @property
    def intact(self) -> bool:
        """Whether every row that was written is what was measured."""
        return not self.corrupt and not self.repeated

    @property
    def complete(self) -> bool:
        return self.intact and not self.missing


def verify(path: Path) -> Verification:
    """Checks every sample's CRC. Raises `InvalidData` where `path` is no scan file."""
    with Recording.open(path) as recording:
        corrupt: list[int] = []
        for start, _, intact in recording.blocks():
            corrupt.extend((np.flatnonzero(~intact) + start).tolist())
        good = np.delete(recording.records["number"], corrupt)
        numbers, times = np.unique(good, return_counts=True)
        return Verification(
            status=recording.status,
            planned=len(recording.plan),
            written=len(recording),
            corrupt=tuple(corrupt),
            repeated=tuple(numbers[times > 1].tolist()),
            missing=tuple(recording.missing()),
        )


def recover(path: Path, target: Path, *, overwrite: bool = False) -> int:
    """Copies header, plan, events and every intact sample of `path` into a new scan file `target`; returns how many
    samples. Raises `InvalidData` where `path` has no complete header, `StorageError` where `target` exists."""
    if target.exists() and not overwrite:
        raise StorageError(f"{target}: exists. Choose another name, or say --overwrite.")
    lock = WriterLock(target)
    try:
        return _salvage(path, target)
    finally:
        lock.release()


def _salvage(path: Path, target: Path) -> int:
    fresh = target.with_name(target.name + ".new")
    with Recording.open(path) as recording:
        lay_out(fresh, recording.plan, recording.header)
        with RecordingWriter(fresh, recording.plan) as writer:
            for event in recording.events():
                writer.log(event.kind, event.text, event.bench_s, event.unix_s)
            taken = set()
            for sample in recording.samples():
                if sample.point.number not in taken:
                    taken.add(sample.point.number)
                    writer.write(sample)
            writer.flush()
            writer.log("salvaged", f"{len(taken)} of {len(recording)} samples were intact")
            writer.finish(Status.COMPLETE if not recording.missing() else Status.INTERRUPTED)
    put_in_place(fresh, target)
    return len(taken)


@dataclass(frozen=True)
class Resumed:
    """Where a scan goes on: `writer` is None where nothing is left to take; `taken` and `elapsed_s` are for `scan`."""

    writer: RecordingWriter | None
    taken: Mapping[int, int]
    elapsed_s: float


def resume(path: Path, plan: ScanPlan, header: Header, *, clock: Clock | None = None) -> Resumed:
    """Goes on where the recording at `path` ends; on a complete one there is nothing to do.

    Without a file, or on one without a complete header, a new recording is begun; what lay there is kept as
    `RUN.h5.unreadable`. Raises `ResumeRefused` where plan, constants or devices are not those of the recording,
    `StorageError` where another process writes it.
    """
    lock = WriterLock(path)
    try:
        if path.exists():
            try:
                check_recording(path)
                with Recording.open(path) as recording:
                    _same_scan(recording, plan, header)
                    taken, elapsed_s = recording.photons(), recording.elapsed_s
            except ResumeRefused:
                raise
            except InvalidData:
                path.replace(path.with_name(path.name + ".unreadable"))
        if not path.exists():
            return Resumed(RecordingWriter.create(path, plan, header, clock=clock, lock=lock), {}, 0.0)
        if not plan.pending(taken):
            lock.release()
            return Resumed(None, taken, elapsed_s)
        _salvage(path, path)
        return Resumed(RecordingWriter(path, plan, lock, clock), taken, elapsed_s)
    except BaseException:
        lock.release()
        raise


def _same_scan(recording: Recording, plan: ScanPlan, header: Header) -> None:
    place = f"{recording.path}: cannot be gone on with: "
    remedy = ". Go back to what it was made with, or start a new recording."
    if recording.plan != plan:
        raise ResumeRefused(f"{place}its plan is not the one given{remedy}")
    if recording.header.constants_json != header.constants_json:
        raise ResumeRefused(f"{place}it was taken with other calibration constants{remedy}")
    if difference := _other_device(recording.header.devices, header.devices):
        raise ResumeRefused(f"{place}{difference}{remedy}")


def _other_device(before: Mapping[str, DeviceIdentity], now: Mapping[str, DeviceIdentity]) -> str:
    for role in sorted({*before, *now}):
        if before.get(role) != now.get(role):
            return f"its {role} was {before.get(role)}, now it is {now.get(role)}"
    return ""
