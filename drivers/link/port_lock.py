"""A serial port kept to this program: no other may open it, whether that one asks or not.

pyserial's `exclusive` is an flock, which only those see who ask for it; ModemManager and a terminal program do not.
TIOCEXCL is the terminal's own lock: the kernel answers every other open with EBUSY, root's excepted, until the port is
closed. A pseudo-terminal is left alone: its far end keeps it alive, and with it the lock of a program that was killed.
"""

import contextlib
import os
from typing import Any

try:
    import fcntl
    import termios
except ImportError:  # Windows opens serial ports for one program anyway
    _LOCK = _UNLOCK = None
else:
    _LOCK, _UNLOCK = getattr(termios, "TIOCEXCL", None), getattr(termios, "TIOCNXCL", None)

_PSEUDO_TERMINALS = range(136, 144)
"""Major numbers of Linux's /dev/pts (Documentation/admin-guide/devices.txt)."""


def lock_out_others(port: Any) -> None:
    """Takes the terminal's lock where `port` is a terminal that has one."""
    _control(port, _LOCK)


def let_others_in(port: Any) -> None:
    """Gives the lock back. Nothing is raised: the port may be gone."""
    _control(port, _UNLOCK)


def _control(port: Any, request: int | None) -> None:
    with contextlib.suppress(OSError, AttributeError, ValueError):  # no file, no terminal, or already gone
        descriptor = port.fileno()
        if request is not None and not _is_pseudo_terminal(descriptor):
            fcntl.ioctl(descriptor, request)


def _is_pseudo_terminal(descriptor: int) -> bool:
    return os.major(os.fstat(descriptor).st_rdev) in _PSEUDO_TERMINALS
