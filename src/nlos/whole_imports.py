"""A kernel's "interrupt" button, or Ctrl-C, within an import: what NumPy, PyYAML or torch make of it stays broken until
Python is started anew."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from nlos.drivers.exit_paths import loads_a_module, signal_soon

_AGAIN_S = 0.02


@contextmanager
def whole_imports() -> Iterator[None]:
    """Within, or in the function that it decorates, an interrupt waits until an import that began there is done. Only
    in the main thread, and where the interrupt is Python's own and no other program's business."""
    ours = threading.current_thread() is threading.main_thread()
    if not (ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler):
        yield
        return
    top = sys._getframe(2)  # behind this one and `__enter__`: who entered the block

    def interrupt(number: int, frame: FrameType | None) -> None:
        if loads_a_module(frame, top):
            signal_soon(number, _AGAIN_S)
        else:
            signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is interrupt:
            signal.signal(signal.SIGINT, signal.default_int_handler)
