"""Whether the disk holds a whole series, before its first scan."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from nlos.acquisition.errors import StorageError
from nlos.series.forecast import Forecast


def check_room(folder: Path, coming: Sequence[tuple[Path, Forecast]]) -> None:
    """Raises `StorageError` where it does not. A recording that is begun has its place already."""
    needed = sum(each.disk_bytes for path, each in coming if not path.exists())
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise StorageError(
            f"{folder}: the series needs {needed / 1e6:.0f} MB, there are {free / 1e6:.0f} MB. Free disk space, "
            "or name another `folder`."
        )
