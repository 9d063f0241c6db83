"""The noise level of successive looks at one scene: found for every eighth of them, told by their counts in between."""

from collections import Counter
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Lock
from typing import TYPE_CHECKING, Optional

if TYPE_CHECKING:
    from torch import Tensor

EVERY = 8
"""Looks of which the noise level is found for one."""
ALIKE = 0.15
"""Decades of counts a point by which a look may differ from the one whose noise level is known."""

_in_use: ContextVar[Optional["KeptNoise"]] = ContextVar("kept_noise", default=None)


class KeptNoise:
    """What looks at one scene share, for a method that asks for it; may be used in several threads."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._looks: Counter[Hashable] = Counter()
        self._known: dict[Hashable, tuple[Tensor, Tensor, Tensor]] = {}

    @contextmanager
    def in_use(self) -> Iterator[None]:
        """While the block lasts, what this thread reconstructs is the next look."""
        token = _in_use.set(self)
        try:
            yield
        finally:
            _in_use.reset(token)

    def of(
        self, where: Hashable, counts: "Tensor", find: Callable[[], tuple["Tensor", "Tensor"]]
    ) -> tuple["Tensor", "Tensor"]:
        """log10 noise level (B,) and its spread over the wall (B, H, W) of a look with so many `counts` (B,) a measured
        point, on one grid and device, `where`: what `find` returns or, of photons alone, what an earlier look's becomes
        with more or fewer of them."""
        with self._lock:
            known, due = self._known.get(where), self._looks[where] % EVERY == 0
            self._looks[where] += 1
        if known is not None and not due:
            counted, level, spread = known
            more = (counts / counted).log10()
            if bool((more.abs() <= ALIKE).all()):
                return level - 0.5 * more, spread
        level, spread = find()
        with self._lock:
            self._known[where] = counts, level, spread
        return level, spread


def kept_noise() -> KeptNoise | None:
    """What is in use in this thread."""
    return _in_use.get()
