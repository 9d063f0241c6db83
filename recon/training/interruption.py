"""SIGINT and SIGTERM during a training: the step under way is finished and saved, a second signal ends at once."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType


@dataclass
class Asked:
    """Whether somebody asked the training to end, and by which signal."""

    number: int | None = None


@contextmanager
def caught() -> Iterator[Asked]:
    """Inside, the first SIGINT or SIGTERM is a wish, the second does what it did before. Outside of a process's main
    thread signals cannot be caught, and are left alone."""
    asked = Asked()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def ask(number: int, frame: FrameType | None) -> None:
        asked.number = number
        for each, handler in before.items():
            signal.signal(each, handler)

    for number in before:
        signal.signal(number, ask)
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
