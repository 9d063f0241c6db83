"""What a disk refuses to give, told apart from what is wrong with a file that lies on it."""

import errno
import os
from pathlib import Path

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.writer_lock import NO_LOCKS

_REFUSALS = {
    getattr(errno, name, None)
    for name in ("EIO", "EREMOTEIO", "ESTALE", "ENOTCONN", "EHOSTDOWN", "ETIMEDOUT", "ENODEV", "ENXIO", "EACCES",
                 "EPERM", "EMFILE", "ENFILE", *(errno.errorcode[number] for number in NO_LOCKS))
} - {None}  # fmt: skip
_MOST_BEHIND = 20


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
