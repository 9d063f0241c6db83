"""Ctrl-C while a library of C++ is loaded: it waits, for some abort the process when it falls into their start."""

import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import FrameType, ModuleType

from nlos.drivers.exit_paths import signal_soon

LIBRARIES = ("torch", "scipy")


@contextmanager
def held_back() -> Iterator[None]:
    """A Ctrl-C comes when the block has ended. Does nothing where someone has a handler of his own: that of a bench
    shuts the light, and does not wait."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    came: list[int] = []

    def later(number: int, frame: FrameType | None) -> None:
        came.append(number)

    try:
        signal.signal(signal.SIGINT, later)
    except ValueError:  # not the main thread, where no Ctrl-C arrives
        yield
        return
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is later:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if came:
            signal_soon(signal.SIGINT)


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname.partition(".")[0] not in LIBRARIES:
            return None
        if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            return None  # held back already, or not to be
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is None or spec.loader is None:
            return None
        loaded = spec.loader.exec_module

        def exec_module(module: ModuleType) -> None:
            with held_back():
                loaded(module)

        spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


def load_libraries_unbroken() -> None:
    """From now on, in this process."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
