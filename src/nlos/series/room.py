"""Whether the disk holds a whole series, before its first scan."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording import megabytes
from nlos.series.forecast import Forecast


def check_room(folder: Path, coming: Sequence[tuple[Path, Forecast]]) -> None:
    """Raises `StorageError` where it does not, be the folder there yet or not. A recording that is begun has its place
    already."""
    there = next((each for each in (folder, *folder.absolute().parents) if each.exists()), folder)
    needed = sum(each.disk_bytes for path, each in coming if not path.exists())
    free = shutil.disk_usage(there).free
    if needed > free:
        raise StorageError(
            f"{folder}: the series needs {megabytes.needed(needed)}, there are {megabytes.free(free)}. "
            "Free disk space, or name another `folder`."
        )
