"""A name that is given to a file only where nothing bears it."""

import os
from pathlib import Path


def put_new(path: Path, target: Path, other: str = "name") -> None:
    """Gives `path` the name `target`, where nothing is; whoever calls removes its old name. Raises `FileExistsError`
    where something is by now; `other`: what else may be chosen with -o."""
    try:
        os.link(path, target)
    except FileExistsError as error:
        raise _taken(target, other) from error
    except (OSError, NotImplementedError) as error:  # a file system that knows no second names
        if os.path.lexists(target):
            raise _taken(target, other) from error
        path.replace(target)


def _taken(target: Path, other: str) -> FileExistsError:
    return FileExistsError(
        f"{target}: exists by now: another program has made it meanwhile. Choose another {other} with -o, or use "
        "--overwrite."
    )
