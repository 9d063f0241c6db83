"""What a rescue may do: write beside, prove, keep. What was acknowledged is never taken away, and no run is mixed."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.follow import follow
from nlos.acquisition.recording.layout import EVENT, EVENT_ROWS, RECORD, STATUS, sample_crc
from nlos.acquisition.recording.open_file import open_scan_file
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.salvage import recover, resume, settle
from nlos.acquisition.recording.same_scan import ResumeRefused
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.recording.writer_lock import WriterLock, is_locked
from nlos.acquisition.sample import Sample
from nlos.acquisition.served.served_copy import copy_served
from nlos.acquisition.served.server import SampleServer
from nlos.acquisition.served.ticket import Ticket
from nlos.drivers.clock import VirtualClock
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag

FORK = multiprocessing.get_context("fork")


def sample(plan: ScanPlan, number: int, seed: int = 0) -> Sample:
    counts = np.random.default_rng([seed, number]).poisson(3.0, plan.axis.bins).astype(np.uint32)
    axis, none = plan.axis, HistogramFlag.NONE
    return Sample(
        plan[number],
        Histogram(counts, axis.bin_width_s, axis.offset_s, 8e-3, 1000, int(counts.sum()), none, number * 8e-3),
        number * 8e-3,
    )


def write(path: Path, plan: ScanPlan, count: int, seed: int = 0, header: Header | None = None) -> Path:
    with RecordingWriter.create(path, plan, header or Header(scan_text="a scan")) as writer:
        for number in range(count):
            writer.write(sample(plan, number, seed))
    return path


def killed(path: Path, plan: ScanPlan, count: int) -> Path:
    """What lies there after a writer was killed with so many samples acknowledged."""

    def dies() -> None:
        writer = RecordingWriter.create(path, plan, Header(scan_text="a scan"))
        for number in range(count):
            writer.write(sample(plan, number))
        writer.flush()
        os.kill(os.getpid(), signal.SIGKILL)

    child = FORK.Process(target=dies)
    child.start()
    child.join()
    return path


def damage(path: Path, row: int) -> None:
    file = open_scan_file(path, writable=True)
    with file.handle:
        counts, _ = file.counts.read(row, row + 1)
        counts = counts.copy()
        counts[0, 5] ^= 0x10
        file.counts.write(row, counts)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_killed_recording_is_resumed_in_its_own_file(run_path: Path, small_plan: Callable[..., ScanPlan]) -> None:
    plan = small_plan()
    killed(run_path, plan, 20)
    inode = run_path.stat().st_ino
    resumed = resume(run_path, plan, Header())
    assert resumed.writer is not None
    for number in range(20, 36):
        resumed.writer.write(sample(plan, number))
    resumed.writer.finish(Status.COMPLETE)
    assert run_path.stat().st_ino == inode
    assert verify(run_path).complete
    assert names(run_path.parent) == {"run.h5"}


def test_a_recording_with_damaged_rows_is_kept_beside_the_one_that_is_resumed(
    run_path: Path, small_plan: Callable[..., ScanPlan]
) -> None:
    plan = small_plan()
    write(run_path, plan, 36)
    damage(run_path, 7)
    before = run_path.read_bytes()
    for attempt in ("run.h5.damaged", "run.h5.damaged-2"):
        resumed = resume(run_path, plan, Header())
        assert resumed.writer is not None
        assert sorted(resumed.taken) == [number for number in range(36) if number != 7]
        resumed.writer.finish(Status.INTERRUPTED)
        assert (run_path.parent / attempt).read_bytes() == before
        run_path.write_bytes(before)
    assert recover(run_path.parent / "run.h5.damaged", run_path.parent / "saved.h5") == 35


def test_a_second_unreadable_file_takes_nothing_from_the_first(
    run_path: Path, small_plan: Callable[..., ScanPlan]
) -> None:
    for text in (b"one", b"two", b"three"):
        run_path.write_bytes(text)
        writer = resume(run_path, small_plan(), Header()).writer
        assert writer is not None
        writer.finish(Status.INTERRUPTED)
    kept = [run_path.with_name(f"run.h5.unreadable{number}") for number in ("", "-2", "-3")]
    assert [path.read_bytes() for path in kept] == [b"one", b"two", b"three"]


@pytest.mark.parametrize("name", ["run.h5.new", "run.h5.lay.new"])
def test_a_link_where_a_new_file_is_laid_out_is_not_followed(
    run_path: Path, small_plan: Callable[..., ScanPlan], name: str
) -> None:
    valuable, link = run_path.with_name("valuable"), run_path.with_name(name)
    valuable.write_text("mine")
    link.symlink_to(valuable)
    write(run_path, small_plan(), 3)
    damage(run_path, 1)
    writer = resume(run_path, small_plan(), Header()).writer
    assert writer is not None
    writer.finish(Status.INTERRUPTED)
    assert valuable.read_text() == "mine"
    assert link.is_symlink()


def test_what_a_killed_process_laid_out_is_cleared_away_and_nothing_else(
    run_path: Path, small_plan: Callable[..., ScanPlan]
) -> None:
    left, other = run_path.with_name(f"run.h5.{'a1' * 8}.new"), run_path.with_name("run.h5.mine.new")
    left.write_bytes(b"half")
    other.write_bytes(b"mine")
    write(run_path, small_plan(), 3)
    assert names(run_path.parent) == {"run.h5", "run.h5.mine.new"}


def test_rows_between_the_writes_of_a_flush_were_never_acknowledged(
    run_path: Path, small_plan: Callable[..., ScanPlan]
) -> None:
    """Counts are there, the records are half there, their number is not: as a kill leaves it."""
    plan = small_plan()
    killed(run_path, plan, 20)
    file = open_scan_file(run_path, writable=True)
    with file.handle:
        records, _ = file.records.read(0, 3)
        records = records.copy()
        records["number"] = (20, 21, 22)
        file.records.write(20, records)  # of other counts: none of the three fits
    found = verify(run_path)
    assert (found.corrupt, found.rows.unacknowledged, found.written) == ((), (20, 21, 22), 20)
    writer = resume(run_path, plan, Header()).writer
    assert writer is not None
    for number in range(20, 36):
        writer.write(sample(plan, number))
    writer.finish(Status.COMPLETE)
    assert verify(run_path).complete


def test_a_scan_killed_after_its_last_sample_is_complete_once_it_is_resumed(
    run_path: Path, small_plan: Callable[..., ScanPlan]
) -> None:
    plan = small_plan()
    killed(run_path, plan, 36)
    with Recording.open(run_path) as recording:
        assert recording.status is Status.RUNNING
    assert len(list(follow(run_path, clock=VirtualClock()))) == 36  # and no advice to resume
    assert settle(run_path, plan)
    assert verify(run_path).status is Status.COMPLETE
    assert not is_locked(run_path)
    assert names(run_path.parent) == {"run.h5"}


def old_recording(path: Path, plan: ScanPlan, count: int, marked: bool) -> None:
    """As the first versions wrote them: no identity, in chunks, marked as being written where they were killed."""
    write(path, plan, count)
    with h5py.File(path, "r") as file:
        kept = {name: file[name][:] for name in ("status", "events", "samples/records", "samples/counts")}
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        del file["header/identity"]
        for name, values in kept.items():
            del file[name]
            rows_a_chunk = min(len(values), 8)
            file.create_dataset(name, data=values, chunks=(rows_a_chunk, *values.shape[1:]))
    if marked:
        flags = h5py.h5f.ACC_RDWR | h5py.h5f.ACC_SWMR_WRITE
        access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
        access.set_libver_bounds(h5py.h5f.LIBVER_V110, h5py.h5f.LIBVER_V110)

        def dies() -> None:
            file = h5py.h5f.open(os.fsencode(path), flags, fapl=access)
            assert file.valid
            os.kill(os.getpid(), signal.SIGKILL)

        child = FORK.Process(target=dies)
        child.start()
        child.join()
        assert path.read_bytes()[11] & 0x04


def test_the_lock_that_a_killed_scan_left_goes_and_one_that_is_held_stays(
    run_path: Path, small_plan: Callable[..., ScanPlan]
) -> None:
    plan = small_plan(2, 2)
    with RecordingWriter.create(run_path, plan, Header()) as writer:
        for number in range(len(plan)):
            writer.write(sample(plan, number))
        writer.finish(Status.COMPLETE)
    lock = run_path.with_name("run.h5.lock")
    lock.touch()
    assert settle(run_path, plan)
    assert not lock.exists()
    held = WriterLock(run_path)
    assert settle(run_path, plan)
    assert lock.exists()
    held.release()


@pytest.mark.parametrize("marked", [False, True])
def test_recordings_of_the_first_versions_are_read_recovered_and_resumed(
    run_path: Path, small_plan: Callable[..., ScanPlan], marked: bool
) -> None:
    plan = small_plan()
    old_recording(run_path, plan, 20, marked)
    with Recording.open(run_path) as recording:
        assert len(recording.header.identity) == 32
        assert len(list(recording.samples())) == 20
    assert recover(run_path, run_path.with_name("saved.h5")) == 20
    resumed = resume(run_path, plan, Header())
    assert resumed.writer is not None
    for number in range(20, 36):
        resumed.writer.write(sample(plan, number))
    resumed.writer.finish(Status.COMPLETE)
    assert verify(run_path).complete


@contextmanager
def serving(run: Path) -> Iterator[Ticket]:
    server, stop = SampleServer(run), threading.Event()
    thread = threading.Thread(target=server.serve, args=(lambda: not stop.is_set(),))
    thread.start()
    try:
        yield server.ticket
    finally:
        stop.set()
        thread.join()
        server.close()


def test_a_mirror_never_joins_two_runs_of_one_plan(tmp_path: Path, small_plan: Callable[..., ScanPlan]) -> None:
    plan = small_plan()
    one, other = write(tmp_path / "one.h5", plan, 36), write(tmp_path / "other.h5", plan, 36, seed=1)
    with Recording.open(one) as a, Recording.open(other) as b:
        assert a.header.identity != b.header.identity
        assert replace(a.header, identity="") == replace(b.header, identity="")
        header = a.header
    far = write(tmp_path / "far.h5", plan, 11, header=header)
    before = far.read_bytes()
    with serving(other) as ticket, pytest.raises(ResumeRefused, match="another run"):
        copy_served(ticket, far, patience_s=20)
    assert far.read_bytes() == before
    with serving(one) as ticket:
        assert copy_served(ticket, far, patience_s=20) == 36
    with Recording.open(far) as copy:
        assert [s.histogram.counts.tobytes() for s in copy.samples()] == [
            sample(plan, number).histogram.counts.tobytes() for number in range(36)
        ]


def test_the_crc_is_what_the_file_format_says(run_path: Path, small_plan: Callable[..., ScanPlan]) -> None:
    """Read by h5py alone, without anything of ours but the checksum's recipe."""
    import zlib

    write(run_path, small_plan(), 9)
    with h5py.File(run_path, "r") as file:
        records, counts = file["samples/records"][:9], file["samples/counts"][:9]
        assert file["samples/records"].dtype == RECORD
        assert (file["events"].dtype, file["status"].dtype, len(file["events"])) == (EVENT, STATUS, EVENT_ROWS)
    for record, histogram in zip(records, counts, strict=True):
        expected = zlib.crc32(record.tobytes()[:47] + histogram.tobytes())
        assert int(record["crc"]) == expected == sample_crc(record.tobytes(), histogram)
