"""What the control groups of this process leave of memory: of a batch system, a container, a service.

Groups lie within each other, and each has a limit of its own. Source: Linux, Documentation/admin-guide/cgroup-v2.rst
and cgroup-v1/memory.rst.
"""

from collections.abc import Iterator
from pathlib import Path

_FILES = {
    2: ("memory.max", "memory.current", ("inactive_file", "active_file")),
    1: ("memory.limit_in_bytes", "memory.usage_in_bytes", ("total_inactive_file", "total_active_file")),
}
"""Version -> the files of a group's limit and use, and the lines of `memory.stat` that are given back when asked for:
of files that were read once, and more often."""


def bytes_left(mounted: Path = Path("/sys/fs/cgroup"), of_process: Path = Path("/proc/self/cgroup")) -> int | None:
    """The least that any of the groups leaves; None where none has a limit."""
    try:
        left = [_left(group, version) for group, version in _groups(mounted, of_process)]
    except (OSError, ValueError):  # of other contents than Linux writes
        return None
    return min((each for each in left if each is not None), default=None)


def _groups(mounted: Path, of_process: Path) -> Iterator[tuple[Path, int]]:
    """This process's group of memory and those that it lies in, to the one that is mounted, with their version."""
    for line in of_process.read_text(errors="surrogateescape").splitlines():
        _, controllers, name = line.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        version, top = (1, mounted / "memory") if controllers else (2, mounted)
        group = top / name.lstrip("/")
        yield top, version
        while group != top:
            yield group, version
            group = group.parent


def _left(group: Path, version: int) -> int | None:
    """None where the group has no limit, or is not to be seen from within a container."""
    of_limit, of_use, of_files = _FILES[version]
    try:
        limit, used = (int((group / name).read_text()) for name in (of_limit, of_use))
    except (OSError, ValueError):  # "max"
        return None
    return limit - max(used - _of_stat(group / "memory.stat", of_files), 0)


def _of_stat(path: Path, keys: tuple[str, ...]) -> int:
    try:
        lines = dict(line.split(" ", 1) for line in path.read_text().splitlines() if " " in line)
        return sum(int(lines.get(key, "0")) for key in keys)
    except (OSError, ValueError):
        return 0
