"""What the whole program shares, and a method of somebody else may have changed, is put back.

A method that goes to another folder, makes warnings errors or takes Ctrl-C would otherwise decide where a scan is
recorded, whether its calibration ends in an error, and whether it can be stopped.
"""

import contextlib
import importlib
import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, NoReturn

import numpy as np

_log = logging.getLogger(__name__)
_lock = threading.RLock()
_inside = 0
_end_process = os._exit
_process = 0
"""Whose threads are inside: what they fork ends as it likes."""
_elsewhere = set[int]()
"""Threads that were there before, and are not inside: a watchdog that finds a method hanging ends the program."""
_Setting = tuple[str, Callable[[], Any], Callable[[Any], object]]
"""In words, what it is, and how it is set."""
_Kept = tuple[str, Any, Callable[[], Any], Callable[[Any], object]]
"""The same, with what it was."""
_before: list[_Kept] = []
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGTSTP") if hasattr(signal, name))


@contextmanager
def put_back(whose: str) -> Iterator[None]:
    """Puts back what was changed within the block, and says whose doing that was; `os._exit`, which would end the
    program with its bench open and nothing said, raises `RuntimeError` there. Where several threads are within such
    blocks, the last one that leaves puts back what was before the first one came; what signals do, which the main
    thread alone can set, that one puts back as it leaves."""
    global _inside, _process, _end_process
    with contextlib.suppress(ImportError):
        importlib.import_module("torch")  # before it is loaded there is nothing of it to put back
    handlers = _as_they_are(_handlers())
    with _lock:
        if _inside == 0:
            _before[:] = _as_they_are(_shared())
            _elsewhere.update(sys._current_frames())
            _process, _end_process, os._exit = os.getpid(), os._exit, _refuse_to_end
        _elsewhere.discard(threading.get_ident())
        _inside += 1
    try:
        with _of_this_thread():
            yield
    finally:
        changed = _returned(handlers)
        with _lock:
            _inside -= 1
            if _inside == 0:
                os._exit = _end_process
                _elsewhere.clear()
                changed += _returned(_before)
        if changed:
            _say_changed(whose, ", ".join(changed))


def _refuse_to_end(status: int) -> NoReturn:
    """In place of `os._exit`, for whoever is neither this program itself, nor a thread of it that is busy elsewhere,
    nor a process that was forked. Who imported it under this name within a block keeps it."""
    caller = str(sys._getframe(1).f_globals.get("__name__", ""))
    if (
        not _inside
        or os.getpid() != _process
        or threading.get_ident() in _elsewhere
        or caller.startswith("nlos.")
        or caller == "__main__"
    ):
        _end_process(status)
    raise RuntimeError(f"os._exit({status}) would have ended the whole program")


@cache
def _say_changed(whose: str, changed: str) -> None:
    """Once, and not with every picture."""
    _log.warning("%s changed %s for the whole program: that is put back", whose, changed)


def _as_they_are(settings: Iterator[_Setting]) -> list[_Kept]:
    return [(what, get(), get, set_) for what, get, set_ in settings]


def _returned(kept: list[_Kept]) -> list[str]:
    """What had changed, in words; it is as it was then."""
    changed = []
    for what, was, get, set_ in kept:
        if get() != was:
            set_(was)
            changed.append(what)
    return changed


def _shared() -> Iterator[_Setting]:
    yield "the current folder", _folder, _go_to
    yield "warnings to errors", _errors_of_warnings, _no_more_errors
    torch = sys.modules.get("torch")
    if torch is not None and hasattr(torch, "get_default_device"):  # else it is being imported
        yield "PyTorch's default type", torch.get_default_dtype, torch.set_default_dtype
        yield (
            "PyTorch's default device",
            torch.get_default_device,
            lambda was: torch.set_default_device(None if was == torch.device("cpu") else was),
        )
        yield (
            "whether PyTorch is deterministic", torch.are_deterministic_algorithms_enabled,
            torch.use_deterministic_algorithms,
        )  # fmt: skip


@contextmanager
def _of_this_thread() -> Iterator[None]:
    """What NumPy does with overflows, whether PyTorch keeps gradients, and how many threads it has."""
    torch = sys.modules.get("torch")
    with np.errstate():
        if torch is None:
            yield
            return
        threads = torch.get_num_threads()
        try:
            with torch.set_grad_enabled(torch.is_grad_enabled()):
                yield
        finally:
            if torch.get_num_threads() != threads:
                torch.set_num_threads(threads)


def _folder() -> str | None:
    try:
        return os.getcwd()
    except OSError:  # it was removed: there is nowhere to go back to
        return None


def _go_to(folder: str | None) -> None:
    if folder is not None:
        with contextlib.suppress(OSError):
            os.chdir(folder)


def _errors_of_warnings() -> list[Any]:
    return [each for each in warnings.filters if each[0] == "error"]


def _no_more_errors(was: list[Any]) -> None:
    kept = [each for each in warnings.filters if each[0] != "error" or each in was]
    warnings.resetwarnings()  # tells Python that they change
    warnings.filters[:] = kept  # type: ignore[index]


def _handlers() -> Iterator[_Setting]:
    if threading.current_thread() is threading.main_thread():  # others cannot set them
        for number in _SIGNALS:
            if signal.getsignal(number) is not None:  # one that no Python set, and none can
                yield f"what {number.name} does", partial(signal.getsignal, number), partial(signal.signal, number)
