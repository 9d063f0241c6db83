"""Under which name a file is written: one that nothing bears, or that of the file behind a link."""

import os
import stat
from pathlib import Path

from nlos.acquisition.errors import StorageError

_MOST_LINKS = 40
"""In a row; Linux follows as many."""


def behind_link(path: Path) -> Path:
    """The file itself, on whatever disk: its lock is beside it, and what is written anew is renamed over it, never over
    a link to it. Every verb writes where a link leads."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def file_to_write(path: Path) -> Path:
    """As `behind_link`, for a file that is written anew. Raises `StorageError` where a device or a pipe would become a
    file, links lead in a circle, or somebody else laid one in a folder that is everybody's, as `/tmp`: it may lead to
    any file of whoever writes (proc_sys_fs(5), protected_symlinks, which a file that is renamed over another evades).
    """
    at = path
    for _ in range(_MOST_LINKS):
        if not os.path.lexists(at):
            return behind_link(path)
        there = at.lstat()
        if not stat.S_ISLNK(there.st_mode):
            if not (stat.S_ISREG(there.st_mode) or stat.S_ISDIR(there.st_mode)):
                raise StorageError(f"{path}: is a device or a pipe, no file that can be replaced. Choose another name.")
            return behind_link(path)
        if _laid_by_another(there, at.parent.stat()):
            raise StorageError(
                f"{path}: {at} is a link to {os.readlink(at)} that somebody else laid in a folder of everybody's. "
                "Choose another name, or name the file itself."
            )
        at = at.parent / os.readlink(at)
    raise StorageError(f"{path}: is a link that leads back to itself. Remove it, or choose another name.")


def _laid_by_another(link: os.stat_result, folder: os.stat_result) -> bool:
    everybodys = folder.st_mode & stat.S_ISVTX and folder.st_mode & stat.S_IWOTH
    return bool(everybodys) and hasattr(os, "geteuid") and link.st_uid not in (os.geteuid(), folder.st_uid)


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
