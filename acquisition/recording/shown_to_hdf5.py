"""HDF5's own view of a file whose bytes pass through this program, opened such that it is over when the block is."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager

import h5py

from nlos.acquisition.recording.file_bytes import HdfBytes


@contextmanager
def shown_to_hdf5(data: HdfBytes, mode: str) -> Iterator[h5py.File]:
    """`data` as an HDF5 file, in the layout of HDF5 1.10 where it is written. Raises what h5py raises.

    Whoever keeps an error keeps the frames that it came through, and h5py's hold what HDF5 calls back into Python when
    it lets go of it: after Python has ended, that crashes the process. So these frames let go at once.
    """
    try:
        with h5py.File(data, mode, libver=("v110", "v110") if mode == "w" else None) as file:
            yield file
    except BaseException as error:
        traceback.clear_frames(error.__traceback__)
        raise
