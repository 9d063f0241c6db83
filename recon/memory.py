"""Whether a reconstruction fits into memory, asked before it starts and not found out by the machine's standstill."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, runtime_checkable

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.control_group import bytes_left

GIB = 1 << 30
_UNKNOWN = 1 << 62
"""Where a system does not say, nothing is refused for want of memory."""


@runtime_checkable
class KnownMemory(Protocol):
    """Settings of a method whose peak memory on a CPU was measured."""

    def bytes_needed(self, wall: WallGrid, time: TimeAxis, told: bool = False) -> int:
        """Peak memory beside the program itself and the counts; `told`: where there is a response to be told."""

    def smaller(self, wall: WallGrid, time: TimeAxis, free: int, told: bool = False) -> Mapping[str, int]:
        """Settings that would take less, the gentlest first: setting -> bytes."""


def available_bytes() -> int:
    """Memory that may still be taken: of the machine, the control groups and this process's own limit."""
    limits = [_of_machine()]
    group = bytes_left()
    if group is not None:
        limits.append(group)
    if sys.platform != "win32":  # which has neither such limits nor the module
        import resource

        own, _ = resource.getrlimit(resource.RLIMIT_AS)
        if own != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc/self/statm").exists() else 0
            limits.append(own - pages * os.sysconf("SC_PAGE_SIZE"))
    return max(min(limits), 0)


def cube_bytes(wall: WallGrid, time: TimeAxis) -> int:
    """One float32 volume of (T, H, W)."""
    return 4 * time.bins * wall.rows * wall.cols


def refusal(
    method: str, wall: WallGrid, time: TimeAxis, needed: int, free: int, remedies: Mapping[str, int]
) -> str | None:
    """Why `needed` bytes are too many, and the first of `remedies` (setting -> bytes) that fits; None if they fit."""
    if needed <= free:
        return None
    what = (
        f"{method} of {wall.rows} x {wall.cols} points x {time.bins} bins takes {_gib(needed)}, {_gib(free)} are free"
    )
    for setting, bytes_then in remedies.items():
        if bytes_then <= free:
            return f"{what}. Use --set {setting} ({_gib(bytes_then)})."
    return f"{what}, and no setting makes that enough. Crop the time axis, or use a machine with more memory."


def _of_machine() -> int:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    if sys.platform == "win32":
        return _UNKNOWN
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _gib(count: int) -> str:
    return f"{count / GIB:.1f} GiB"
