"""One writer per scan file, and files that appear under their name only when they are whole."""

import os
import time
from pathlib import Path
from typing import IO

from nlos.acquisition.errors import StorageError


class WriterLock:
    """One writer per scan file: an advisory lock on `RUN.h5.lock`, gone with the process that holds it."""

    def __init__(self, path: Path) -> None:
        self._path = path.with_name(path.name + ".lock")
        self._file: IO[bytes] | None = None
        try:
            import fcntl
        except ImportError:  # Windows: HDF5's own lock has to do
            return
        try:
            self._file = self._path.open("ab")
            for attempts_left in (2, 1, 0):  # a reader that looks whether the file is locked holds it for a moment
                try:
                    fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if not attempts_left:
                        raise
                    time.sleep(0.02)
        except BlockingIOError as error:
            if self._file:
                self._file.close()
            raise StorageError(
                f"{path}: another process is writing it. Wait for it, or choose another name."
            ) from error
        except OSError as error:
            raise StorageError(f"{path}: cannot be written there ({error})") from error

    def release(self) -> None:
        """May be called twice."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            self._file.close()
            self._file = None


def put_in_place(fresh: Path, path: Path) -> None:
    """Renames `fresh` to `path` in one step that a power cut cannot undo. Raises `StorageError`."""
    try:
        os.replace(fresh, path)
        if os.name == "posix":
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
    except OSError as error:
        raise StorageError(f"{path}: cannot be put in place ({error})") from error


def is_locked(path: Path) -> bool:
    """Whether a living process is writing the scan file `path`. Where the system has no such locks: always False."""
    try:
        import fcntl

        with path.with_name(path.name + ".lock").open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except (ImportError, OSError):
        return False
    return False
