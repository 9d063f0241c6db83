"""What is said of a scan that is looked at again and again: each kind of line once."""

import logging
from collections.abc import Callable

log = logging.getLogger(__name__)

Tell = Callable[..., None]
"""As `logging.Logger.log`: level, words, what goes into them."""


class SaidOnce:
    """Hands on the first line of each level and words, whatever goes into them."""

    def __init__(self) -> None:
        self._said: set[tuple[int, str]] = set()

    def __call__(self, level: int, words: str, *values: object) -> None:
        if (level, words) not in self._said:
            self._said.add((level, words))
            log.log(level, words, *values)
