"""Under which name a file is written: one that nothing bears, or that of the file behind a link."""

import os
from pathlib import Path


def behind_link(path: Path) -> Path:
    """The file itself, on whatever disk: its lock is beside it, and what is written anew is renamed over it, never over
    a link to it. Every verb writes where a link leads."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def put_new(path: Path, target: Path, other: str = "name") -> None:
    """Gives `path` the name `target`, where nothing is; whoever calls removes its old name. Raises `FileExistsError`
    where something is by now; `other`: what else may be chosen with -o."""
    try:
        os.link(path, target)
    except FileExistsError as error:
        if not os.path.samestat(os.lstat(path), os.lstat(target)):  # a network share asks twice where an answer is lost
            raise _taken(target, other) from error
    except FileNotFoundError:  # its own folder is gone, say: no name is taken for what is not there
        raise
    except (OSError, NotImplementedError):
        _put_without_second_names(path, target, other)


def _put_without_second_names(path: Path, target: Path, other: str) -> None:
    """On memory sticks and some network shares. Of two programs one makes the empty file that the name is taken by."""
    try:
        os.close(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    except FileExistsError as error:
        raise _taken(target, other) from error
    try:
        path.replace(target)
    except BaseException:
        if os.path.lexists(path):  # else a signal came when it had its new name already
            target.unlink(missing_ok=True)
        raise


def _taken(target: Path, other: str) -> FileExistsError:
    return FileExistsError(
        f"{target}: exists by now: another program has made it meanwhile. Choose another {other} with -o, or use "
        "--overwrite."
    )
