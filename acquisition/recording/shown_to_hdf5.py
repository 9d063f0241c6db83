"""HDF5's own view of a file whose bytes pass through this program, opened such that it is over when the block is."""

import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType

import h5py

from nlos.acquisition.recording.file_bytes import HdfBytes
from nlos.drivers.exit_paths import a_bench_is_open, undisturbed


@contextmanager
def shown_to_hdf5(data: HdfBytes, mode: str, layout: str = "v110") -> Iterator[h5py.File]:
    """`data` as an HDF5 file; where it is written, in the layout of HDF5 1.10 or another. Raises what h5py raises.

    Whoever keeps an error keeps the frames that it came through, and h5py's hold what HDF5 calls back into Python when
    it lets go of it: after Python has ended, that crashes the process. So these frames let go at once.
    """
    try:
        with _signals_wait(), h5py.File(data, mode, libver=(layout, "v110") if mode == "w" else None) as file:
            yield file
    except BaseException as error:
        traceback.clear_frames(error.__traceback__)
        raise


@contextmanager
def written_hdf5(path: Path) -> Iterator[h5py.File]:
    """A new HDF5 file that readers of any version read. Raises `OSError` where the disk does not take it, at the end of
    the block: HDF5 itself must not meet that, it would crash the process later."""
    with path.open("w+b", buffering=0) as raw:
        shown = HdfBytes(raw.fileno(), str(path))
        with shown_to_hdf5(shown, "w", "earliest") as file:
            yield file
        if shown.failure is not None:
            raise OSError(shown.failure.errno, shown.failure.strerror, str(path))


@contextmanager
def _signals_wait() -> Iterator[None]:
    """While HDF5 calls back into Python, what a signal's handler raises waits for the end of the block: HDF5 would take
    the exception for a failure of the disk. What it does it does at once: it may shut the light of a bench that another
    thread opened. So does a bench that this one opened."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are handled elsewhere
    elif a_bench_is_open():
        with undisturbed():
            yield
    else:
        with ExitStack() as afterwards:
            for number in signal.valid_signals():
                handler = signal.getsignal(number)
                if callable(handler):
                    _put_off(number, handler, afterwards)
            yield


def _put_off(number: int, handler: Callable[[int, FrameType | None], object], afterwards: ExitStack) -> None:
    """From now on what `handler` raises is raised `afterwards`, when it has its place back; without the frames of h5py
    that the signal came into, which must not be kept by an error either."""
    raised: list[BaseException] = []

    def at_once(number: int, frame: FrameType | None) -> None:
        under_way = sys.exception()
        try:
            handler(number, frame)
        except BaseException as error:
            if error.__context__ is under_way:
                error.__context__ = None
            raised.append(error.with_traceback(None))

    def delivered() -> None:
        signal.signal(number, handler)
        if raised:
            raise raised[0]

    signal.signal(number, at_once)
    afterwards.callback(delivered)
