"""A recording that another process is writing, as a source of samples that ends when the scan does."""

from collections.abc import Iterator
from pathlib import Path

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.recording.checked import open_checked
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer_lock import is_locked
from nlos.acquisition.sample import Sample
from nlos.drivers.clock import Clock, SystemClock

POLL_S = 0.2
LAST_LOOKS = 5
"""How often the end of a finished scan is looked at anew before a sample counts as damaged."""
LEFT_ALONE_S = 5.0
"""A file that nobody holds any more gets so long to change before its writer is taken for dead."""


def follow(path: Path, *, patience_s: float = 60.0, clock: Clock | None = None) -> Iterator[Sample]:
    """The intact samples of `path`, those already there first, then each as it is acknowledged, until the scan ends.

    Waits at most `patience_s` for the file to appear (`TimeoutError`); then for as long as a writer holds it, pauses
    included. Goes on through a crash and `--resume`. Raises `InvalidData` for a file that is no recording and that
    nobody writes, `StorageError` where the writer is gone for good.
    """
    clock = clock or SystemClock()
    given = looks = 0
    while True:
        with _opened(path, patience_s, clock) as recording:
            identity = path.stat().st_ino
            row, alone_since_s = 0, clock.now()
            skip = given
            while True:
                over = recording.status is not Status.RUNNING
                recording.refresh()
                whole = True
                for sample in recording.rows(row):
                    if sample is None and not (over and looks >= LAST_LOOKS):
                        whole = False  # still on its way to the disk, or to this handle
                        break
                    row += 1
                    alone_since_s = clock.now()
                    if sample is not None and skip:
                        skip -= 1  # given before the file was replaced by its resumed self
                    elif sample is not None:
                        given += 1
                        yield sample
                if over and ((whole and row >= recording.acknowledged) or looks >= LAST_LOOKS):
                    return
                if over:
                    # What another handle of this process has cached may be older than the end of the scan.
                    looks += 1
                    clock.sleep(POLL_S)
                    break
                if not path.exists() or path.stat().st_ino != identity:
                    break
                if is_locked(path):
                    alone_since_s = clock.now()
                elif clock.now() - alone_since_s > LEFT_ALONE_S:
                    raise StorageError(
                        f"{path}: its writer is gone after {given} samples. Go on with --resume, or save them: recover."
                    )
                clock.sleep(POLL_S)


def _opened(path: Path, patience_s: float, clock: Clock) -> Recording:
    """The recording, once it is there. A file that cannot be read yet may be on its way."""
    began_s = clock.now()
    deadline_s = began_s + patience_s
    while True:
        try:
            return open_checked(path)
        except (FileNotFoundError, InvalidData) as error:
            if path.exists() and not is_locked(path) and clock.now() - began_s > LEFT_ALONE_S:
                raise
            if clock.now() >= deadline_s:
                raise TimeoutError(f"{path}: no recording to follow after {patience_s:g} s ({error})") from error
        clock.sleep(POLL_S)
