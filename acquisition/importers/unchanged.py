"""Whether a file still is what it was when somebody began to read it: of one that changes meanwhile nobody knows what
was read."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nlos.acquisition.errors import InvalidData, StorageError


@contextmanager
def unchanged(path: Path, *, grows: bool = False) -> Iterator[None]:
    """Raises `StorageError` at the end of the block where `path` is another file by then, or one that was written to,
    which one that `grows`, a recording with its checksums, may be. One that is gone was read before."""
    before = _as_it_is(path, grows)
    try:
        yield
    except InvalidData as error:  # half of a file is damaged, too
        _refuse_another(path, before, grows, error)
        raise
    _refuse_another(path, before, grows)


def _refuse_another(path: Path, before: list[int], grows: bool, why: Exception | None = None) -> None:
    now = _as_it_is(path, grows)
    if before and now and now != before:
        raise StorageError(
            f"{path}: has changed while it was read: another program writes it, or put another file in its place. "
            "Nothing was made of it. Wait until that is done, and try again."
        ) from why


def _as_it_is(path: Path, grows: bool) -> list[int]:
    """Empty where it is not there."""
    try:
        now = os.stat(path)
    except OSError:
        return []
    return [now.st_dev, now.st_ino] if grows else [now.st_dev, now.st_ino, now.st_size, now.st_mtime_ns]
