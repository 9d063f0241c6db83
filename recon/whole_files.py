"""Files that appear in a folder together, each whole, in the place of older ones."""

import os
import secrets
import shutil
import signal
import threading
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from nlos.acquisition.recording.disk_refusal import told_of
from nlos.acquisition.recording.new_name import put_new


@contextmanager
def whole_files(folder: Path, stale: Collection[str] = (), *, new: bool = False) -> Iterator[Path]:
    """A hidden folder inside `folder` to write files to. When the block ends they take their places in `folder`, and
    files named in `stale` that were not written anew go; where the block fails, nothing changes. Raises `StorageError`
    where the disk does not take them, and of `new` ones `FileExistsError` where others have taken a place by then."""
    there_before = folder.exists()
    partial = folder / f".{os.getpid()}-{secrets.token_hex(4)}.part"  # in a container a killed one had the same number
    with told_of(folder, partial), _ended_in_order():
        try:
            partial.mkdir(parents=True)
            yield partial
            with _told_later():
                fresh = sorted(partial.iterdir())
                if new:  # of two programs at once the first file is one's, and with it all of them
                    put_new(fresh[0], folder / fresh[0].name, "folder")
                for name in set(stale) - {path.name for path in fresh}:
                    (folder / name).unlink(missing_ok=True)
                for path in fresh[1:] if new else fresh:
                    path.replace(folder / path.name)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
            if not there_before:
                with suppress(OSError):
                    folder.rmdir()  # where nothing came of it


@contextmanager
def _ended_in_order() -> Iterator[None]:
    """Where SIGTERM would end the program on the spot, it ends it by an exception: nothing half-written is left."""
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return

    def end(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def _told_later() -> Iterator[None]:
    """A signal that ends the program waits for the end of the block: some of the files would be new and some old."""
    if threading.current_thread() is not threading.main_thread():  # signals are handled in the main thread alone
        yield
        return
    came: list[int] = []
    numbers = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) not in (None, signal.SIG_IGN)]
    before = {number: signal.signal(number, lambda which, frame: came.append(which)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for told in came[:1]:
            signal.raise_signal(told)
