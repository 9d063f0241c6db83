"""What makes a sample safe, step by step: the order of writes, syncs, events that a disk refuses, what is resumed."""

import errno
import os
import stat
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import pytest

from nlos.acquisition.errors import StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.empty_file import lay_out
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.rescue import copied, written_unix_s
from nlos.acquisition.recording.salvage import recover, resume
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.recording.writer import SYNC_S, RecordingWriter
from nlos.drivers.clock import VirtualClock
from tests.acquisition.killed_scans import FORK
from tests.acquisition.test_resuming import sample, write

Plans = Callable[..., ScanPlan]


def test_counts_are_written_before_what_names_them_and_both_before_they_are_acknowledged(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, order = small_plan(), []
    with RecordingWriter.create(run_path, plan, Header().stamped()) as writer:
        for kind in {type(each) for each in (writer._file.counts, writer._file.records, writer._file.status)}:
            monkeypatch.setattr(kind, "write", spied(kind.write, order, writer))
        writer.write(sample(plan, 0))
        writer.flush()
        assert order == ["counts", "records", "status"]
        assert writer.acknowledged == 1


def spied(write: Callable[..., Any], order: list[str], writer: RecordingWriter) -> Callable[..., Any]:
    """The same write, which says of what."""
    names = {id(getattr(writer._file, name)): name for name in ("counts", "records", "status", "events")}

    def spy(stored: Any, *rest: Any) -> Any:
        order.append(names[id(stored)])
        return write(stored, *rest)

    return spy


def test_the_disk_is_told_to_keep_it_every_five_seconds_and_at_the_end(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, clock, synced = small_plan(), VirtualClock(), []
    sync = os.fsync
    writer = RecordingWriter.create(run_path, plan, Header().stamped(), clock=clock)
    monkeypatch.setattr(os, "fsync", lambda number: synced.append(clock.now()) or sync(number))
    for number in range(20):
        clock.sleep(1.0)
        writer.write(sample(plan, number))
    assert synced == [SYNC_S, 2 * SYNC_S, 3 * SYNC_S, 4 * SYNC_S]
    writer.finish(Status.INTERRUPTED)
    assert len(synced) == 5


@pytest.mark.parametrize(("number", "said"), [(errno.EIO, r"4 samples are safe in it\. Perhaps 3 more are\. Free"),
                                              (errno.ENOSPC, r"7 samples are safe in it\. Free")])  # fmt: skip
def test_of_a_disk_that_is_gone_only_what_was_synced_is_called_safe(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch, number: int, said: str
) -> None:
    """What was written since goes with a stick that is pulled out, or with a computer at the other end."""
    plan, clock = small_plan(), VirtualClock()
    writer = RecordingWriter.create(run_path, plan, Header().stamped(), clock=clock)
    for taken in range(7):  # synced with the fifth
        clock.sleep(1.0)
        writer.write(sample(plan, taken))
    with monkeypatch.context() as gone:
        gone.setattr(type(writer._file.counts), "write", refusing(number))
        clock.sleep(1.0)
        with pytest.raises(StorageError, match=said):
            writer.write(sample(plan, 7))
    with pytest.raises(StorageError, match=said):
        writer.finish(Status.FAILED)


def test_what_the_lock_meets_on_a_disk_that_is_gone_does_not_hide_what_is_safe(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = RecordingWriter.create(run_path, small_plan(), Header().stamped())
    writer.write(sample(writer.plan, 0))
    close = os.close
    monkeypatch.setattr("nlos.acquisition.recording.writer_lock._is_named", refusing(errno.EIO))
    with monkeypatch.context() as share:
        share.setattr(os, "close", lambda number: (close(number), refusing(errno.EIO)()))
        with pytest.raises(StorageError, match=r" 0 samples are safe in it\. Free"):
            writer.finish(Status.COMPLETE)
    assert writer._file.handle.closed


def refusing(number: int) -> Callable[..., Any]:
    def refuses(*words: object) -> Any:
        raise OSError(number, os.strerror(number))

    return refuses


def test_rows_that_are_not_there_when_they_are_read_back_are_not_acknowledged(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = small_plan()
    writer = RecordingWriter.create(run_path, plan, Header().stamped())
    writer.write(sample(plan, 0))
    with monkeypatch.context() as lossy:
        lossy.setattr(type(writer._file.records), "write", lambda *_: None)
        with pytest.raises(StorageError, match="lost what was written to row 0"):
            writer.flush()
    assert writer.acknowledged == 0
    with pytest.raises(StorageError, match="1 samples are safe in"):
        writer.finish(Status.FAILED)


def test_a_sample_that_is_there_already_is_copied_once(run_path: Path, small_plan: Plans) -> None:
    """As one is that was written, but not yet acknowledged, when the file lost its name."""
    plan = small_plan()
    write(run_path, plan, 5)
    with Recording.open(run_path) as recording:
        pending = recording.records[3:5].copy(), recording.counts_of(3, 5)
        twice = pending[0][[0, 0, 1]], pending[1][[0, 0, 1]]
        fresh, samples = copied(recording, run_path, Status.FAILED, ("salvaged", "copied"), [pending, twice])
    assert samples == 5
    with Recording.open(fresh) as copy:
        assert [each.point.number for each in copy.samples()] == list(range(5))
        assert copy.acknowledged == 5
        assert not copy.condition().left_aside


def test_a_recording_that_holds_a_point_twice_is_resumed_to_its_end(run_path: Path, small_plan: Plans) -> None:
    """Its file has as many rows as the plan has points, and no more."""
    plan = small_plan()
    with RecordingWriter.create(run_path, plan, Header().stamped()) as writer:
        for number in (0, 1, 2, 3, 3, 4):
            writer.write(sample(plan, number))
    resumed = resume(run_path, plan, Header())
    assert resumed.writer is not None
    with resumed.writer as writer:
        for number in range(5, len(plan)):
            writer.write(sample(plan, number))
    with Recording.open(run_path) as recording:
        assert [each.point.number for each in recording.samples()] == list(range(len(plan)))
        assert recording.status is Status.COMPLETE


@pytest.mark.parametrize(("count", "status"), [(5, Status.INTERRUPTED), (36, Status.COMPLETE)])
def test_what_is_recovered_is_complete_only_where_nothing_is_missing(
    run_path: Path, small_plan: Plans, count: int, status: Status
) -> None:
    write(run_path, small_plan(), count)
    assert recover(run_path, run_path.with_name("saved.h5")) == count
    with Recording.open(run_path.with_name("saved.h5")) as saved:
        assert saved.status is status
    with pytest.raises(StorageError, match="is the recording itself"):
        recover(run_path, run_path, overwrite=True)


def test_a_copy_was_last_written_to_when_what_it_is_of_was(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(run_path, small_plan(), 5)
    with Recording.open(run_path) as recording:
        written_s = written_unix_s(recording)
        monkeypatch.setattr(time, "time", lambda: written_s + 1000.0)
        fresh, _ = copied(recording, run_path, Status.FAILED, ("salvaged", "copied"))
    with Recording.open(fresh) as copy:
        assert written_unix_s(copy) == written_s


def test_a_copy_is_believed_once_it_is_read_back(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that drops the histograms and says nothing."""
    write(run_path, small_plan(), 5)
    with Recording.open(run_path) as recording, monkeypatch.context() as lossy:
        lossy.setattr(type(recording._file.counts), "write", dropping(type(recording._file.counts).write))
        with pytest.raises(StorageError, match=r"what was copied is not what is there\. Nothing was changed"):
            copied(recording, run_path, Status.FAILED, ("salvaged", "copied"))
    assert [path.name for path in run_path.parent.iterdir()] == ["run.h5"]


def dropping(write: Callable[..., Any]) -> Callable[..., Any]:
    """The same write, of nothing where histograms are meant."""
    return lambda stored, first, rows: write(stored, first, rows if rows.dtype.names else 0 * rows)


def test_an_event_that_the_disk_refuses_holds_nothing_up_and_is_told_by_the_next_flush(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = small_plan()
    writer = RecordingWriter.create(run_path, plan, Header().stamped())
    writer.write(sample(plan, 0))

    def refuses(*_: object) -> None:
        raise OSError(errno.ENOSPC, "no space left")

    with monkeypatch.context() as full:
        full.setattr(type(writer._file.events), "write", refuses)
        writer.log("shutter", "closed")
    with pytest.raises(StorageError, match="the disk refused a write"):
        writer.flush()
    with pytest.raises(StorageError, match="the disk refused a write"):
        writer.finish(Status.FAILED)


def test_a_scan_that_is_left_half_way_says_so_and_goes_on_with_its_events(run_path: Path, small_plan: Plans) -> None:
    plan = small_plan()
    with RecordingWriter.create(run_path, plan, Header().stamped()) as writer:
        writer.log("note", "first", 0.5)
        for number in range(len(plan) - 1):
            writer.write(sample(plan, number))
    with Recording.open(run_path) as recording:
        assert recording.status is Status.INTERRUPTED
    resumed = resume(run_path, plan, Header())
    assert resumed.writer is not None
    with resumed.writer as writer:
        writer.write(sample(plan, len(plan) - 1))
    with Recording.open(run_path) as recording:
        assert recording.status is Status.COMPLETE
        assert [event.kind for event in recording.events()] == ["note", "resumed"]


@pytest.mark.parametrize(("ago_s", "away_s"), [(90.0, 90.0), (-500.0, 0.0)])
def test_a_scan_goes_on_as_late_as_it_was_left_for(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch, ago_s: float, away_s: float
) -> None:
    """By the latest that the file tells of, here an event a second after the last sample; a clock that was put back
    tells nothing. The first point was lit at the beginning."""
    plan, began_s = small_plan(), time.time()
    with RecordingWriter.create(run_path, plan, Header().stamped()) as writer:
        for number in range(1, 10):
            writer.write(sample(plan, number))
        last_s = 10 * 8e-3
        writer.log("pause", "somebody looks", last_s + 1.0, began_s)
    monkeypatch.setattr(time, "time", lambda: began_s + ago_s)
    resumed = resume(run_path, plan, Header())
    assert resumed.writer is not None
    resumed.writer.finish(Status.INTERRUPTED)
    assert resumed.away_s == pytest.approx(away_s, abs=2.0)
    assert resumed.elapsed_s == pytest.approx(last_s + 1.0 + resumed.away_s, abs=1e-6)
    assert resumed.lit_s == pytest.approx(8e-3)


@pytest.mark.parametrize("then_unix_s", [1e9, 60.0, 4e9])
def test_what_is_taken_after_the_computers_clock_was_set_is_whole(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch, then_unix_s: float
) -> None:
    """A computer without a battery begins in 1970 until its network has told it the time. Read by h5py alone: every
    row's bench time is one that `nlos verify` takes, whatever the clock said before and says now."""
    plan, now_unix_s = small_plan(), time.time()
    monkeypatch.setattr(time, "time", lambda: then_unix_s)
    with RecordingWriter.create(run_path, plan, Header().stamped()) as writer:
        for number in range(10):
            writer.write(sample(plan, number))
    monkeypatch.setattr(time, "time", lambda: now_unix_s)
    resumed = resume(run_path, plan, Header())
    assert resumed.writer is not None
    with resumed.writer as writer:
        for number in range(10, len(plan)):
            writer.write(replace(sample(plan, number), taken_s=resumed.elapsed_s + number * 8e-3))
    with h5py.File(run_path) as file:
        assert file["samples/records"]["taken_s"].max() < 60.0
        assert b"clock was set" in file["events"]["text"][0]
    assert verify(run_path).complete


@pytest.mark.parametrize(("limit", "most", "cure"), [("FSIZE", 4096, "ulimit -f"), ("NOFILE", 0, "ulimit -n")])
def test_what_cannot_be_laid_out_is_told_what_stands_in_the_way(
    run_path: Path, small_plan: Plans, limit: str, most: int, cure: str
) -> None:
    """Limits of the session, set by the system itself: neither is cured by freeing disk space."""
    resource = pytest.importorskip("resource")
    plan, said = small_plan(), FORK.Array("c", 400)

    def lays_out() -> None:
        free = os.open(os.devnull, os.O_RDONLY)  # of the numbers below the limit none is
        number = getattr(resource, f"RLIMIT_{limit}")
        resource.setrlimit(number, (most or free, resource.getrlimit(number)[1]))
        try:
            lay_out(run_path, plan, Header())
        except StorageError as error:
            said.value = str(error).encode()[:400]
        os._exit(0)

    child = FORK.Process(target=lays_out)
    child.start()
    child.join()
    assert cure in said.value.decode()
    assert "disk space" not in said.value.decode()
    assert not list(run_path.parent.glob("*.new"))


def test_a_recording_is_rescued_beside_itself_where_no_folder_for_temporary_files_is_usable(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: ["/proc/no-such-folder"])
    plan = small_plan()
    writer = RecordingWriter.create(run_path, plan, Header().stamped())
    for number in range(10):
        writer.write(sample(plan, number))
    run_path.unlink()
    with pytest.raises(StorageError, match=r"was deleted.*10 samples are safe in .*run\.h5\.rescued"):
        writer.finish(Status.FAILED)
    assert verify(run_path.with_name("run.h5.rescued")).rows.damaged == ()


def test_a_scan_that_was_left_twice_knows_how_long_nobody_was_scanning(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two breaks by the clock on the wall, of 100 and 1000 s: bench time less them is what points took."""
    plan, unix_s = small_plan(), time.time()
    monkeypatch.setattr(time, "time", lambda: unix_s)
    resumed = resume(run_path, plan, Header().stamped())
    for number, break_s in enumerate((100.0, 1000.0, 0.0)):
        assert resumed.writer is not None
        resumed.writer.write(replace(sample(plan, number), taken_s=resumed.elapsed_s + 1.0))
        resumed.writer.finish(Status.INTERRUPTED)
        unix_s += break_s
        resumed = resume(run_path, plan, Header())
    assert resumed.writer is not None
    resumed.writer.finish(Status.INTERRUPTED)
    assert resumed.away_s == pytest.approx(1100.0, abs=0.1)
    assert resumed.elapsed_s == pytest.approx(1100.0 + 3 * (1.0 + sample(plan, 0).histogram.live_time_s), abs=0.1)


@pytest.mark.skipif(os.name != "posix", reason="folders are not synced")
@pytest.mark.parametrize(("number", "is_there"), [(errno.EINVAL, True), (errno.EIO, False)])
def test_a_share_that_syncs_no_folders_takes_recordings(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch, number: int, is_there: bool
) -> None:
    """SMB shares refuse that for every folder (EINVAL); what a disk refuses is told."""
    real = os.fsync

    def refused(fd: int) -> None:
        if stat.S_ISDIR(os.fstat(fd).st_mode):
            raise OSError(number, os.strerror(number))
        real(fd)

    monkeypatch.setattr(os, "fsync", refused)
    if is_there:
        RecordingWriter.create(run_path, small_plan(), Header()).finish(Status.COMPLETE)
        assert Recording.open(run_path).status is Status.COMPLETE
    else:
        with pytest.raises(StorageError, match=r"cannot be put in place .* -o"):
            RecordingWriter.create(run_path, small_plan(), Header())
