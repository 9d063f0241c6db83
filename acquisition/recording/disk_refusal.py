"""What a disk refuses to give or to take, told of the file that a person knows, with what to do."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.writer_lock import NO_LOCKS

_REFUSALS = {
    getattr(errno, name, None)
    for name in ("EIO", "EREMOTEIO", "ESTALE", "ENOTCONN", "EHOSTDOWN", "ETIMEDOUT", "ENODEV", "ENXIO", "EACCES",
                 "EPERM", "EMFILE", "ENFILE", *(errno.errorcode[number] for number in NO_LOCKS))
} - {None}  # fmt: skip
GONE = {
    getattr(errno, name, None)
    for name in ("EIO", "EREMOTEIO", "ESTALE", "ENOTCONN", "EHOSTDOWN", "ETIMEDOUT", "ENODEV", "ENXIO", "EROFS")
} - {None}
"""What a disk says, or its network share, that has failed as a whole, or was pulled out."""
_NO_FOLDER = {errno.ENOSPC, errno.EROFS, errno.EIO, getattr(errno, "EDQUOT", errno.ENOSPC)}
_MOST_BEHIND = 20
_MAKE_ROOM = "Free disk space, or choose another place with -o."
_OPEN = "That is no matter of the disk: close what else is open, or raise the limit (ulimit -n)."
_REMEDIES = {
    errno.ENOSPC: _MAKE_ROOM,
    getattr(errno, "EDQUOT", errno.ENOSPC): _MAKE_ROOM,
    errno.EFBIG: "Its file system, or a limit of this session (ulimit -f), takes no file that large: choose another "
    "place with -o, or write less into one file.",
    errno.ENAMETOOLONG: "Choose a shorter one.",
    errno.EMFILE: _OPEN,
    errno.ENFILE: _OPEN,
}


def disk_refusal(path: Path | str, error: BaseException) -> StorageError | None:
    """The error to raise instead, where a refusal of the disk's is behind `error`, whatever a library or a reader made
    of it; None where nothing is known against the disk."""
    behind: list[BaseException] = [error]
    for each in behind:
        if isinstance(each, OSError) and each.errno == errno.EAGAIN:
            return StorageError(f"{path}: another program has it open for writing. Close it there, and try again.")
        if isinstance(each, OSError) and each.errno is not None and each.errno in _REFUSALS:
            return StorageError(
                f"{path}: cannot be read ({os.strerror(each.errno)}), which says nothing about what is in it. Nothing "
                "was changed. See to its disk, or copy it to a sound one, and try again there."
            )
        more = (each.__cause__, each.__context__)
        behind += [one for one in more if one is not None and len(behind) < _MOST_BEHIND]
    return None


def remedy(error: BaseException) -> str:
    """What helps against a disk that does not take a file."""
    return _REMEDIES.get(getattr(error, "errno", None) or 0, "Choose another place with -o.")


@contextmanager
def told_of(target: Path, partial: Path) -> Iterator[None]:
    """What a disk refuses of `partial`, or of files in it, is told of `target`, which it becomes. Raises
    `StorageError`."""
    try:
        yield
    except OSError as error:
        named = partial if error.filename is None else Path(os.fsdecode(error.filename))
        made = named == target and error.errno in _NO_FOLDER  # a folder that was to be made for them
        if error.errno is None or not (made or named.is_relative_to(partial)):
            raise
        place = target if made else target / named.relative_to(partial)
        raise StorageError(f"{place}: cannot be written ({error.strerror}). {remedy(error)}") from error
