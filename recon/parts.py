"""Tells whoever waits how far a method has come: the parts of its network, one after the other, and what takes long
inside one of them: iterations, planes, mirror images."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from torch import Tensor, nn

Heard = Callable[[int, int, str], None]
"""(how many parts are done, of how many, the name of the last one)"""

_heard: ContextVar[Heard | None] = ContextVar("heard", default=None)
_within: ContextVar[Heard | None] = ContextVar("within", default=None)
T = TypeVar("T")


@contextmanager
def heard_by(listener: Heard | None, within: Heard | None = None) -> Iterator[None]:
    """While the block lasts, `listener` is told of every part that is done, in this thread, and `within` of every round
    of a long loop inside one."""
    tokens = _heard.set(listener), _within.set(within)
    try:
        yield
    finally:
        _heard.reset(tokens[0])
        _within.reset(tokens[1])


def counted(rounds: Iterable[T], total: int, name: str) -> Iterator[T]:
    """The same, each told of when it is done."""
    within = _within.get()
    for done, each in enumerate(rounds, 1):
        yield each
        if within is not None:
            within(done, total, name)


@contextmanager
def told(module: "nn.Module") -> Iterator[None]:
    """Tells of the parts of `module` that have none of their own, each when it is done for the first time."""
    listener = _heard.get()
    if listener is None:
        yield
        return
    parts = {name: part for name, part in module.named_modules() if name and not list(part.children())}
    done: set[str] = set()

    def finished(name: str) -> None:
        if name not in done:
            done.add(name)
            listener(len(done), len(parts), name)

    def hook(name: str) -> "Callable[[nn.Module, tuple[Tensor, ...], object], None]":
        return lambda part, given, made: finished(name)

    hooks = [part.register_forward_hook(hook(name)) for name, part in parts.items()]
    try:
        yield
    finally:
        for each in hooks:
            each.remove()
    for name in parts:  # what the network skips with these settings
        finished(name)
