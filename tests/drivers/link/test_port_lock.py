"""An open serial port is locked by the terminal's own lock, and free again when it is closed."""

import array
import contextlib
import os
import sys
from collections.abc import Iterator

import pytest

from nlos.drivers.clock import SystemClock
from nlos.drivers.link import port_lock
from nlos.drivers.link.serial_line import SerialLine

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="TIOCGEXCL is Linux's")
_TIOCGEXCL = 0x80045440


@contextlib.contextmanager
def terminal() -> Iterator[str]:
    controller, port = os.openpty()
    try:
        yield os.ttyname(port)
    finally:
        os.close(controller)
        os.close(port)


def locked(path: str, descriptor: int | None = None) -> bool:
    """Asked over a second descriptor, which only root gets from a locked port."""
    import fcntl

    second = os.open(path, os.O_RDWR | os.O_NOCTTY) if descriptor is None else descriptor
    try:
        answer = array.array("i", [0])
        fcntl.ioctl(second, _TIOCGEXCL, answer)
        return bool(answer[0])
    finally:
        if descriptor is None:
            os.close(second)


def opened(path: str) -> SerialLine:
    return SerialLine.open(
        "port", path, SystemClock(), baud=9600, timeout_s=0.1, resynchronise=lambda line, stale: None
    )


def test_a_port_is_locked_from_open_to_close(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(port_lock, "_PSEUDO_TERMINALS", range(0))  # the only terminal at hand is one
    with terminal() as path:
        line = opened(path)
        assert locked(path, line._port.fileno())
        line.close()
        assert not locked(path)
        line.close()


def test_a_pseudo_terminal_is_not_locked_since_it_would_stay_so_after_a_kill() -> None:
    with terminal() as path:
        line = opened(path)
        assert not locked(path)
        line.close()
