"""Whether results can be written to a folder, asked before minutes of work are done for them."""

import tempfile
from pathlib import Path


def check_writable(folder: Path) -> None:
    """Raises `PermissionError` where no file can be made in `folder` or, as long as that is not there, in the folder
    that it would be made in; `FileExistsError` where that is a file. Leaves nothing behind."""
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    if not there.is_dir():
        raise FileExistsError(f"{folder}: {there} is a file, not a folder. Choose another place with -o.")
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise PermissionError(
            f"{folder}: nothing can be written to {there} ({error.strerror}). Choose another place with -o."
        ) from error
