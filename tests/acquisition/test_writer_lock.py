"""Of all who want to write a scan file one may, however often it changes hands."""

import errno
import multiprocessing
import os
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

import pytest

from nlos.acquisition.errors import StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording import writer_lock
from nlos.acquisition.recording.layout import Status
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.salvage import resume, settle
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.recording.writer_lock import WriterLock, clear_left_lock, is_locked
from tests.acquisition.test_resuming import killed, names, sample

FORK = multiprocessing.get_context("fork")
TAKES = 400


def contend(path: Path, holders: "Synchronized[int]", taken: "Synchronized[int]", twice: "Synchronized[int]") -> None:
    """Takes the lock as often as it can be had, and counts who else believes to have it."""
    while taken.value < TAKES:
        try:
            lock = WriterLock(path)
        except StorageError:
            continue
        with holders.get_lock():
            holders.value += 1
            twice.value += holders.value > 1
        time.sleep(0)
        with holders.get_lock():
            holders.value -= 1
            taken.value += 1
        lock.release()


def test_no_two_processes_ever_hold_the_lock_of_one_file(tmp_path: Path) -> None:
    holders, taken, twice = (FORK.Value("q", 0) for _ in range(3))
    rivals = [FORK.Process(target=contend, args=(tmp_path / "run.h5", holders, taken, twice)) for _ in range(4)]
    for rival in rivals:
        rival.start()
    for rival in rivals:
        rival.join()
    assert taken.value >= TAKES
    assert twice.value == 0
    assert list(tmp_path.iterdir()) == []


def test_who_opened_the_lock_before_it_was_released_does_not_hold_it(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    first = WriterLock(path)
    inode = path.with_name("run.h5.lock").stat().st_ino
    with path.with_name("run.h5.lock").open("rb"):  # keeps the number of the old file from being given again
        first.release()
        second = WriterLock(path)
        assert path.with_name("run.h5.lock").stat().st_ino != inode
        assert is_locked(path)
        with pytest.raises(StorageError, match="another process"):
            WriterLock(path)
    second.release()
    assert not is_locked(path)


def test_a_link_in_the_locks_place_is_not_followed(tmp_path: Path) -> None:
    target = tmp_path / "valuable"
    target.write_text("mine")
    (tmp_path / "run.h5.lock").symlink_to(target)
    with pytest.raises(StorageError):
        WriterLock(tmp_path / "run.h5")
    assert target.read_text() == "mine"


@pytest.fixture
def broken_into_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A Ctrl-C as the lock is asked for."""
    lock, asked = writer_lock._lock, []

    def broken_into(fd: int, shared: bool = False) -> bool:
        asked.append(fd)
        if len(asked) == 1:
            raise KeyboardInterrupt
        return lock(fd, shared)

    monkeypatch.setattr(writer_lock, "_lock", broken_into)


@pytest.mark.usefixtures("broken_into_once")
def test_who_is_broken_into_while_taking_the_lock_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        WriterLock(tmp_path / "run.h5")
    assert list(tmp_path.iterdir()) == []
    WriterLock(tmp_path / "run.h5").release()


def test_who_is_broken_into_leaves_the_lock_that_another_holds(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    held = WriterLock(tmp_path / "run.h5")
    request.getfixturevalue("broken_into_once")
    with pytest.raises(KeyboardInterrupt):
        WriterLock(tmp_path / "run.h5")
    assert is_locked(tmp_path / "run.h5")
    held.release()


def test_who_fails_to_mark_a_scan_complete_leaves_it_to_the_next_who_tries(
    run_path: Path, small_plan: Callable[..., ScanPlan], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(writer: RecordingWriter, status: Status) -> None:
        raise StorageError("no space left")

    plan = small_plan()
    killed(run_path, plan, len(plan))
    with monkeypatch.context() as changed:
        changed.setattr(RecordingWriter, "finish", full)
        with pytest.raises(StorageError, match="no space left"):
            settle(run_path, plan)
    assert not is_locked(run_path)
    assert settle(run_path, plan)
    assert names(run_path.parent) == {"run.h5"}


def _resumes(path: Path, plan: ScanPlan, begun: "Synchronized[int]", ended: "Synchronized[int]") -> None:
    """Another process: takes all that is missing, once it is let."""
    resumed = resume(path, plan, Header())
    assert resumed.writer is not None
    begun.value = 1
    while not ended.value:
        time.sleep(0.01)
    with resumed.writer as writer:
        for number in set(range(len(plan))) - set(resumed.taken):
            writer.write(sample(plan, number))
    ended.value = 2


@pytest.mark.parametrize("resumed_meanwhile", [True, False])
def test_who_tidies_a_lock_away_does_not_make_two_writers(
    tmp_path: Path, small_plan: Callable[..., ScanPlan], resumed_meanwhile: bool
) -> None:
    """`rm *.lock` while a scan runs. Every row that is in the file in the end is what was measured."""
    plan, path = small_plan(), tmp_path / "run.h5"
    begun, ended = FORK.Value("q", 0), FORK.Value("q", 0)
    writer = RecordingWriter.create(path, plan, Header().stamped())
    writer.write(sample(plan, 0))
    writer.flush()
    path.with_name("run.h5.lock").unlink()
    if resumed_meanwhile:
        other = FORK.Process(target=_resumes, args=(path, plan, begun, ended))
        other.start()
        try:
            while not begun.value:
                time.sleep(0.01)
                assert other.is_alive()
            with suppress(StorageError):  # where it came to a flush by then
                writer.write(sample(plan, 1))
            with pytest.raises(StorageError, match="another process writes it now"):
                writer.finish(Status.FAILED)
            assert is_locked(path)  # it is the other's
        finally:
            ended.value = 1
            other.join()
        assert ended.value == 2
        assert verify(path).complete
    else:
        writer.write(sample(plan, 1))
        writer.flush()
        assert is_locked(path)
        writer.finish(Status.INTERRUPTED)
        assert verify(path).rows.damaged == ()
    assert not path.with_name("run.h5.lock").exists()


@pytest.mark.skipif(os.name != "posix", reason="flock")
@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP])
def test_on_a_file_system_without_locks_nobody_writes_and_everybody_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refused(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("fcntl.flock", refused)
    with pytest.raises(StorageError, match=r"run\.h5: its file system has no locks .*-o"):
        WriterLock(tmp_path / "run.h5")
    assert list(tmp_path.iterdir()) == []
    lock = tmp_path / "run.h5.lock"  # of a scan that was killed, copied here with its recording
    lock.touch()
    assert not is_locked(tmp_path / "run.h5")
    clear_left_lock(tmp_path / "run.h5")


def test_a_lock_that_may_not_be_deleted_is_given_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, lock = tmp_path / "run.h5", WriterLock(tmp_path / "run.h5")

    def refused(*_: object, **__: object) -> None:
        raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))

    with monkeypatch.context() as patched:
        patched.setattr(os, "unlink", refused)
        lock.release()
    assert not is_locked(path)
    WriterLock(path).release()
