"""A file that appears whole or not at all, in the place of an older one."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nlos.acquisition.recording.disk_refusal import told_of
from nlos.acquisition.recording.new_name import file_to_write, put_new
from nlos.writable import check_writable


@contextmanager
def whole_file(target: Path, *, new: bool = False) -> Iterator[Path]:
    """A path beside `target`, or beside the file that it is a link to, to write to: it becomes that file when the block
    ends, and is removed where that fails.
    Of a `new` one raises `FileExistsError` where another has taken its place by then.
    Raises `FileNotFoundError` where there is no folder for it, `IsADirectoryError` where it is one,
    `StorageError` where the disk does not take it, and as `check_writable` does."""
    if target.is_dir():
        raise IsADirectoryError(f"{target}: is a folder. Name the file in it.")
    if not new:
        target = file_to_write(target)
    if not target.absolute().parent.is_dir():
        raise FileNotFoundError(f"{target.parent}: no such folder. Make it, or choose another place with -o.")
    check_writable(target.parent)
    partial = target.with_name(f".{target.name}.{os.getpid()}-{secrets.token_hex(4)}.part")  # two may write it at once
    try:
        with told_of(target, partial):
            yield partial
            if new:
                put_new(partial, target)
            else:
                partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)
