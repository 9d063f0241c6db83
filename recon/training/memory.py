"""Whether a training fits into memory, asked before anything large is made, and said in words where it still runs out.

What is known beforehand is a least: making one sample took 38 bytes for each of its bins (96 x 96 points, 384 bins),
and three batches of counts are there at a time. Networks come on top; `nlos train --check` measures those.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from nlos.recon.errors import ReconstructionFailed
from nlos.recon.memory import GIB, available_bytes
from nlos.recon.training.feed import AHEAD
from nlos.recon.training.train_settings import TrainSettings

SAMPLE_BYTES = 32
"""For a bin of the sample that is being made."""
COUNT_BYTES = 4


def least_bytes(settings: TrainSettings) -> int:
    """What all processes of this machine together take at the least."""
    data = settings.data
    each = data.rows * data.cols * data.bins
    here, world = (int(os.environ.get(name, "1")) for name in ("LOCAL_WORLD_SIZE", "WORLD_SIZE"))
    counts = COUNT_BYTES * (AHEAD + 1) * settings.batch * here // world
    return each * (SAMPLE_BYTES * here * max(1, settings.workers or 0) + counts)


def too_large(settings: TrainSettings) -> str | None:
    """Why this training does not fit here, and what would; None where it may."""
    needed, free = least_bytes(settings), available_bytes()
    if needed <= free:
        return None
    return (
        f"{_size(settings)} takes {needed / GIB:.1f} GiB at the least, {free / GIB:.1f} GiB are free: take fewer "
        "points, bins, batch or workers"
    )


@contextmanager
def out_of_memory_in_words(settings: TrainSettings) -> Iterator[None]:
    """What an allocator says becomes `ReconstructionFailed` with what to change."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        said = str(error).splitlines()[0] if str(error) else "no memory"
        short = isinstance(error, MemoryError | torch.OutOfMemoryError) or "allocate memory" in str(error)
        if not short:
            raise
        raise ReconstructionFailed(
            f"memory ran out ({said}): {_size(settings)} is too much for this machine with this network. Take fewer "
            "points, bins, channels, or a smaller batch."
        ) from error


def _size(settings: TrainSettings) -> str:
    data = settings.data
    return f"a batch of {settings.batch} of {data.rows} x {data.cols} points x {data.bins} bins"
