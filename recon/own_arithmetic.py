"""Arithmetic as methods learned it, whatever the program that asks for a picture has set for its own."""

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import torch

_lock = Lock()
_within = 0
_theirs: "torch.dtype | None" = None


@contextmanager
def own_arithmetic() -> Iterator[None]:
    """Within, or in the function that it decorates: NumPy makes no error of a number that becomes 0, and torch computes
    on the processor, in float32, where nothing else is asked for. What was set is set again afterwards."""
    with np.errstate(divide="warn", over="warn", under="ignore", invalid="warn"), ExitStack() as stack:
        if sys.modules.get("torch") is not None:  # who has not loaded it has set nothing
            _own_torch(stack)
        yield


def _own_torch(stack: ExitStack) -> None:
    import torch

    for kind in ("cpu", "cuda"):
        if torch.is_autocast_enabled(kind):
            stack.enter_context(torch.autocast(kind, enabled=False))
    if torch.is_inference_mode_enabled():  # networks are kept for the next picture, which may be made outside of it
        stack.enter_context(torch.inference_mode(False))
    if torch.get_default_device().type != "cpu":
        stack.enter_context(torch.device("cpu"))
    stack.enter_context(_float32())


@contextmanager
def _float32() -> Iterator[None]:
    """Torch has one default for all threads: the first who comes sets it, the last who goes sets it back."""
    import torch

    global _within, _theirs
    with _lock:
        if not _within:
            _theirs = torch.get_default_dtype()
            torch.set_default_dtype(torch.float32)
        _within += 1
    try:
        yield
    finally:
        with _lock:
            _within -= 1
            if not _within and _theirs is not None:
                torch.set_default_dtype(_theirs)
