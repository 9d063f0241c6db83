"""What is said of a scan's light: in the log, or to whoever looks at one again and again and says each thing once."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_TELL: ContextVar[Callable[..., None] | None] = ContextVar("nlos_calibration_told", default=None)
log = logging.getLogger(__name__)


@contextmanager
def told_to(tell: Callable[..., None]) -> Iterator[None]:
    """Within it, `tell` is told in place of the log: level, words, what goes into them, as `logging.Logger.log`."""
    before = _TELL.set(tell)
    try:
        yield
    finally:
        _TELL.reset(before)


def warn(words: str, *values: object) -> None:
    """A doubt of the light itself, as `logging.Logger.warning`."""
    (_TELL.get() or log.log)(logging.WARNING, words, *values)
