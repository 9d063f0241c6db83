"""Pictures of successive frames, made at the same time on a core each, and shown in the order of the frames."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from typing import TypeVar

from nlos.recon.transport.fourier import on_one_core

T = TypeVar("T")


class InOrder:
    """Up to `cores` at a time. Threads that share the small operations of one picture wait for each other; those that
    make a picture each do not."""

    def __init__(self, cores: int, freed: Callable[[], None] = lambda: None) -> None:
        """`freed` is called whenever one has been shown and its core may be given another."""
        self._cores, self._freed = cores, freed
        self._pool = ThreadPoolExecutor(cores, thread_name_prefix="picture")
        self._begun: deque[Future[None]] = deque()

    @property
    def full(self) -> bool:
        """Whether every core has a picture to make. Raises what making or showing one has raised."""
        while self._begun and self._begun[0].done():
            self._begun.popleft().result()
        return len(self._begun) >= self._cores

    def begin(self, make: Callable[[], T], show: Callable[[T], None]) -> None:
        """`show(make())` in a thread, shown once those that were begun before have been."""
        before = self._begun[-1] if self._begun else None

        def one() -> None:
            with on_one_core():
                made = make()
            if before is not None:
                wait([before])
            show(made)

        picture = self._pool.submit(one)
        self._begun.append(picture)
        picture.add_done_callback(lambda done: self._freed())

    def finish(self) -> None:
        """Returns when all are shown. Raises what making or showing one has raised."""
        while self._begun:
            self._begun.popleft().result()

    def stop(self) -> None:
        """The same, whatever they raise; nothing can be begun any more."""
        while self._begun:
            with suppress(Exception):
                self._begun.popleft().result()
        self._pool.shutdown()
