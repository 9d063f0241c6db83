"""Files damaged at random, reproducibly: bytes flipped, blocks overwritten, ends cut off, parts repeated."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

Damage = Callable[[Path, Path, int], Iterator[Path]]


def damaged_copies(whole: Path, damaged: Path, count: int) -> Iterator[Path]:
    """`count` times a damaged copy of `whole` under the name `damaged`."""
    raw = np.frombuffer(whole.read_bytes(), np.uint8)
    # Headers are where a parser can be led astray; most damage goes there.
    head = min(len(raw), 4096)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        copy = raw.copy()
        where = int(rng.integers(0, head if rng.random() < 0.8 else len(raw)))
        match int(rng.integers(0, 4)):
            case 0:
                flips = rng.integers(0, head, int(rng.integers(1, 8)))
                copy[flips] = rng.integers(0, 256, len(flips))
            case 1:
                copy[where : where + 8] = rng.choice([0, 1, 127, 255], len(copy[where : where + 8]))
            case 2:
                copy = copy[:where]
            case 3:
                copy = np.concatenate([copy[:where], copy[where // 2 :]])
        damaged.write_bytes(copy.tobytes())
        yield damaged


@pytest.fixture
def damage() -> Damage:
    return damaged_copies
