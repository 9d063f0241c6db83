"""A complete, empty scan file: every dataset at its place, the disk space reserved, before the first sample."""

import errno
import itertools
import os
import re
import secrets
import shutil
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from nlos.acquisition.errors import StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.disk_refusal import remedy
from nlos.acquisition.recording.file_bytes import HdfBytes
from nlos.acquisition.recording.header import FORMAT, VERSION, write_header, write_plan
from nlos.acquisition.recording.layout import EVENT, EVENT_ROWS, RECORD, STATUS, Status
from nlos.acquisition.recording.megabytes import needed
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.shown_to_hdf5 import shown_to_hdf5

_NO_FOLDER_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS)
"""What network shares say that keep folders elsewhere: a file that took its place there has it."""
_FRESH = r"\.[0-9a-f]{16}\.new"


def lay_out(target: Path, plan: ScanPlan, header: Header) -> Path:
    """Lays the file out beside `target`, on disk, under a name that nobody has, and returns that name.

    For whoever holds the target's lock: what a killed process left half done there is deleted. Raises `StorageError`
    where the disk has no room for the whole scan; of one until it is stopped no room is reserved.
    """
    points, bins = plan.most_samples, plan.axis.bins
    fresh = target.with_name(f"{target.name}.{secrets.token_hex(8)}.new")
    try:
        clear(target)
        with open(os.open(fresh, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666), "r+b") as raw:
            shown = HdfBytes(raw.fileno(), str(target))
            with shown_to_hdf5(shown, "w") as file:
                file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
                write_header(file, header.named())
                write_plan(file, plan)
                rows = [_announce(file, "status", (1,), STATUS), _announce(file, "events", (EVENT_ROWS,), EVENT)]
                rows += [_announce(file, "samples/records", (points,), RECORD)]
                rows += [_announce(file, "samples/counts", (points, bins), np.dtype("<u4"))]
                # A dataset gets its place with its first value: by then everything that says what is where has its
                # own, further in front, so that an incomplete copy still knows.
                file.flush()
                for dataset in rows:
                    dataset[0] = np.zeros(dataset.shape[1:], dataset.dtype)
                rows[0][0] = (Status.RUNNING, 0, time.time())
            if shown.failure is not None:
                raise shown.failure
            if hasattr(os, "posix_fallocate") and not plan.until_stopped:
                os.posix_fallocate(raw.fileno(), 0, os.fstat(raw.fileno()).st_size)
            os.fsync(raw.fileno())
    except (OSError, RuntimeError) as error:
        fresh.unlink(missing_ok=True)
        size = points * (bins * 4 + RECORD.itemsize)
        raise StorageError(
            f"{target}: cannot reserve {needed(size)} for {points} points of {bins} bins ({error}). {remedy(error)}"
        ) from error
    return fresh


def put_in_place(fresh: Path, path: Path) -> None:
    """Renames `fresh` to `path` in one step that a power cut cannot undo. Raises `StorageError`."""
    try:
        os.replace(fresh, path)
        if os.name == "posix":
            _sync_folder(path.parent)
    except OSError as error:
        raise StorageError(f"{path}: cannot be put in place ({error}). Choose another place with -o.") from error


def _sync_folder(path: Path) -> None:
    """Raises `OSError` where a power cut could undo what was renamed in it."""
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    except OSError as error:
        if error.errno not in _NO_FOLDER_SYNC:
            raise
    finally:
        os.close(folder)


def keep_as(file: Path, path: Path, word: str) -> Path:
    """Gives `file` the name `PATH.WORD` as well, or the next that is free, and returns it. Raises `StorageError`."""
    numbers = itertools.count(2)
    kept = path.with_name(f"{path.name}.{word}")
    while True:
        try:
            os.link(file, kept, follow_symlinks=False)
            return kept
        except FileExistsError:
            kept = path.with_name(f"{path.name}.{word}-{next(numbers)}")
        except (OSError, NotImplementedError) as error:
            return _copied(file, kept, error)


def _copied(file: Path, kept: Path, why: Exception) -> Path:
    """A copy, where the file system knows no second names."""
    try:
        with file.open("rb") as source, kept.open("xb") as copy:
            shutil.copyfileobj(source, copy)
            copy.flush()
            os.fsync(copy.fileno())
    except OSError as error:
        raise StorageError(f"{file}: cannot be kept as {kept.name} ({why}; {error})") from error
    return kept


def clear(target: Path) -> None:
    """Deletes what was left half done beside `target`: for whoever holds its lock."""
    for left in target.parent.glob(f"{_escaped(target.name)}.*.new"):
        if re.fullmatch(re.escape(target.name) + _FRESH, left.name) and left.is_file() and not left.is_symlink():
            left.unlink(missing_ok=True)


def _escaped(name: str) -> str:
    return re.sub(r"([*?[])", r"[\1]", name)


def _announce(file: h5py.File, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> h5py.Dataset:
    """A dataset in one piece; what is never written in it reads as zeros."""
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_layout(h5py.h5d.CONTIGUOUS)
    layout.set_alloc_time(h5py.h5d.ALLOC_TIME_LATE)
    layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    links = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    links.set_create_intermediate_group(True)
    stored, space = h5py.h5t.py_create(dtype, logical=True), h5py.h5s.create_simple(shape)
    return h5py.Dataset(h5py.h5d.create(file.id, name.encode(), stored, space, dcpl=layout, lcpl=links))
