"""What the control groups of this process leave of memory and of processor time: of a batch system, a container, a
service.

Groups lie within each other, and each has a limit of its own. Source: Linux, Documentation/admin-guide/cgroup-v2.rst,
cgroup-v1/memory.rst and scheduler/sched-bwc.rst.
"""

import os
from collections.abc import Iterator
from pathlib import Path

_MOUNTED, _OF_PROCESS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")

_FILES = {
    2: ("memory.max", "memory.current", ("inactive_file", "active_file")),
    1: ("memory.limit_in_bytes", "memory.usage_in_bytes", ("total_inactive_file", "total_active_file")),
}
"""Version -> the files of a group's limit and use, and the lines of `memory.stat` that are given back when asked for:
of files that were read once, and more often."""


def bytes_left(mounted: Path = _MOUNTED, of_process: Path = _OF_PROCESS) -> int | None:
    """The least that any of the groups leaves; None where none has a limit."""
    try:
        left = [_left(group, version) for group, version in _groups("memory", mounted, of_process)]
    except (OSError, ValueError):  # of other contents than Linux writes
        return None
    return min((each for each in left if each is not None), default=None)


def processors() -> int:
    """How many threads can compute at a time: the processors that this process may run on, or the fewer whose time its
    groups grant it."""
    return granted() or _allowed()


def granted(mounted: Path = _MOUNTED, of_process: Path = _OF_PROCESS) -> int | None:
    """The processors whose time the tightest of the groups grants, a begun one whole; None where that is no fewer than
    this process may run on. More threads than that all wait for the rest of a period once its time is spent."""
    try:
        shares = [_share(group, version) for group, version in _groups("cpu", mounted, of_process)]
    except (OSError, ValueError):
        return None
    allowed = _allowed()
    least = min((-(-time // period) for time, period in filter(None, shares)), default=allowed)
    return least if least < allowed else None


def _allowed() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _groups(controller: str, mounted: Path, of_process: Path) -> Iterator[tuple[Path, int]]:
    """This process's group of a controller and those that it lies in, to the one that is mounted, with their
    version."""
    for line in of_process.read_text(errors="surrogateescape").splitlines():
        _, controllers, name = line.split(":", 2)
        if controllers and controller not in controllers.split(","):
            continue
        version, top = (1, mounted / controller) if controllers else (2, mounted)
        group = top / name.lstrip("/")
        yield top, version
        while group != top:
            yield group, version
            group = group.parent


def _share(group: Path, version: int) -> tuple[int, int] | None:
    """The time that a group may compute in each period, and that period, both in microseconds; None as in `_left`."""
    files = ("cpu.max",) if version == 2 else ("cpu.cfs_quota_us", "cpu.cfs_period_us")
    try:
        time, period = map(int, " ".join((group / name).read_text() for name in files).split())
    except (OSError, ValueError):  # "max 100000"
        return None
    return (time, period) if min(time, period) > 0 else None  # -1: no limit


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
