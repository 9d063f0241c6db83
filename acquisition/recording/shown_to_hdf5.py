"""HDF5's own view of a file whose bytes pass through this program, opened such that it is over when the block is."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from nlos.acquisition.recording.file_bytes import HdfBytes


@contextmanager
def shown_to_hdf5(data: HdfBytes, mode: str, layout: str = "v110") -> Iterator[h5py.File]:
    """`data` as an HDF5 file; where it is written, in the layout of HDF5 1.10 or another. Raises what h5py raises.

    Whoever keeps an error keeps the frames that it came through, and h5py's hold what HDF5 calls back into Python when
    it lets go of it: after Python has ended, that crashes the process. So these frames let go at once.
    """
    try:
        with h5py.File(data, mode, libver=(layout, "v110") if mode == "w" else None) as file:
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
