"""Whether results can be written to a folder, asked before minutes of work are done for them."""

import os
import tempfile
from pathlib import Path


def check_writable(folder: Path, option: str = "-o") -> None:
    """Raises `PermissionError` where no file can be made in `folder` or, as long as that is not there, in the folder
    that it would be made in; `FileExistsError` where that is a file or a link to nothing, as to a disk that is not
    mounted. `option`: by what another place is chosen. Leaves nothing behind."""
    there = folder.absolute()
    while not there.exists():
        if there.is_symlink():
            raise FileExistsError(
                f"{folder}: {there} is a link to {os.readlink(there)}, which is not there. Mount or make that, or "
                f"choose another place with {option}."
            )
        there = there.parent
    if not there.is_dir():
        raise FileExistsError(f"{folder}: {there} is a file, not a folder. Choose another place with {option}.")
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise PermissionError(
            f"{folder}: nothing can be written to {there} ({error.strerror}). Choose another place with {option}."
        ) from error
