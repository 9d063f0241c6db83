"""One writer per scan file: a lock on `RUN.h5.lock` that goes with the process that holds it."""

import errno
import os
import time
from contextlib import suppress
from pathlib import Path

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.new_name import behind_link

TRIES = 10
TRY_AGAIN_S = 0.01
NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)
"""What file systems without locks say: network shares whose lock service does not run, some clusters' disks."""


def lock_file(path: Path) -> Path:
    """The file that whoever writes the scan file `path` holds a lock on. Raises `IsADirectoryError` for `.` and `/`."""
    if not path.name:
        raise IsADirectoryError(f"{path}: is a folder. Name the file in it.")
    return path.with_name(path.name + ".lock")


class WriterLock:
    """Held from construction until `release`. Raises `StorageError` where another process, or this one, holds it.

    The lock's file is removed by its holder, while it is held. Who opened it before then holds a lock on a file that
    has no name any more: whoever gets a lock looks whether its file still is the one of that name.
    """

    def __init__(self, path: Path) -> None:
        self._of, self._path = path, lock_file(path)
        self._fd: int | None = None
        try:
            taken = self._take()
        except OSError as error:
            raise StorageError(f"{path}: {_refusal(error)}") from error
        if not taken:
            raise StorageError(f"{path}: another process is writing it. Wait for it, or choose another name.")

    def keep(self) -> None:
        """Before a write. Somebody who tidies up may have removed the lock's file: it is made anew. Raises
        `StorageError` where another process has begun to write the scan file meanwhile."""
        before = self._fd
        if before is None or _is_named(before, self._path):
            return
        try:
            taken = self._take()
        except OSError:  # a folder that takes no new file any more has no other writer either
            return
        if not taken:
            raise StorageError(
                f"{self._of}: another process writes it now, for {self._path.name} was removed. Nothing more is "
                "written here; leave the lock's file alone while a scan runs."
            )
        os.close(before)

    def _take(self) -> bool:
        for tries_left in range(TRIES - 1, -1, -1):
            if self._attempt():
                return True
            if tries_left:  # a reader that looks whether the file is locked holds it for a moment
                time.sleep(TRY_AGAIN_S)
        return False

    def _attempt(self) -> bool:
        fd = os.open(self._path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        try:
            if _lock(fd) and _is_named(fd, self._path):
                self._fd = fd
                return True
        except BaseException as error:
            # A Ctrl-C, say: the file that was made here goes with it, unless it has become another holder's.
            try:
                if os.name == "posix" and (has_no_locks(error) or _lock(fd)) and _is_named(fd, self._path):
                    self._path.unlink()
            finally:
                os.close(fd)
            raise
        os.close(fd)
        return False

    def release(self) -> None:
        """May be called twice. In a folder where nothing may be deleted the lock's file stays, as on a disk that is
        gone: nobody holds it."""
        fd, self._fd = self._fd, None
        if fd is not None:
            try:
                with suppress(OSError):
                    if os.name == "posix" and _is_named(fd, self._path):  # else it is another holder's
                        self._path.unlink()
            finally:
                with suppress(OSError):  # what network shares say whose other end is gone; it is closed all the same
                    os.close(fd)


def clear_left_lock(path: Path) -> None:
    """Removes the lock's file where a process that was killed left it; one that is held stays."""
    if lock_file(path).exists():
        with suppress(StorageError):
            WriterLock(path).release()


def is_locked(path: Path) -> bool:
    """Whether a living process is writing the scan file `path`, or the one that this is a link to; not where there are
    no locks: nobody writes there."""
    try:
        fd = os.open(lock_file(behind_link(path)), os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0))
    except OSError:
        return False
    try:
        return not _lock(fd, shared=True)
    except OSError as error:
        if has_no_locks(error):
            return False
        raise
    finally:
        os.close(fd)


def has_no_locks(error: BaseException) -> bool:
    """Whether it is a file system without locks that speaks."""
    return isinstance(error, OSError) and error.errno in NO_LOCKS


def _refusal(error: OSError) -> str:
    if not has_no_locks(error):
        return f"cannot be written there ({error.strerror}). Choose another place."
    return (
        f"its file system has no locks ({error.strerror}), and without one two programs could write one file. Choose "
        "another disk with -o, or have that one mounted with locks."
    )


def _lock(fd: int, shared: bool = False) -> bool:
    """Whether the lock was to be had."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        try:
            msvcrt.locking(fd, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        except OSError:
            return False
        return True
    try:
        fcntl.flock(fd, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_named(fd: int, path: Path) -> bool:
    """Whether the open file still is the one at `path`."""
    try:
        named = os.stat(path, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return os.path.samestat(os.fstat(fd), named)
