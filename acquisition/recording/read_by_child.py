"""Scan files from anywhere, read to their end by a child first: no damage reaches the process that uses them."""

from pathlib import Path

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.isolated import check_isolated
from nlos.acquisition.importers.magic import is_recording
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer_lock import is_locked

_RESULTS = "reconstruction.h5"
"""What `nlos reconstruct` calls its results."""
_READER = "nlos.acquisition.recording.read_by_child:read_through"


def open_checked(path: Path) -> Recording:
    """`Recording.open`, once `check_recording` has passed. A file that a living process writes is as sound as that."""
    if not is_locked(path):
        check_recording(path)
    recording = Recording.open(path)
    try:
        _ = recording.status
    except BaseException:
        recording.close()
        raise
    return recording


def check_recording(path: Path) -> None:
    """Has a child read the file to its end. Raises `FileNotFoundError`, and `InvalidData` where `path` is not a
    recording, or one that no process survives."""
    check_says_recording(path)
    check_isolated(path, _READER)


def check_says_recording(path: Path) -> None:
    """By its first bytes alone. Raises `FileNotFoundError`, `IsADirectoryError` and `InvalidData`."""
    if is_recording(path):
        return
    if path.name == _RESULTS:
        raise InvalidData(f"{path}: is a reconstruction, not a recording. Name the recording that it was made from.")
    raise InvalidData(
        f"{path}: is not a recording, or its beginning is damaged. `nlos import {path.name} -o RUN.h5` makes one "
        "of other formats."
    )


def read_through(path: Path) -> None:
    """Everything that verbs read. What a row holds is judged by whoever uses it. Raises `InvalidData`."""
    with Recording.open(path) as recording:
        recording.events()
        for _ in recording.blocks():
            pass
