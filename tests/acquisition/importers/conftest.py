"""Damaged copies of a file, one after the other."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.damaged import mutated

Damage = Callable[[Path, Path, int], Iterator[Path]]


def damaged_copies(whole: Path, damaged: Path, count: int) -> Iterator[Path]:
    """`count` times a damaged copy of `whole` under the name `damaged`."""
    raw = np.frombuffer(whole.read_bytes(), np.uint8)
    for seed in range(count):
        damaged.write_bytes(mutated(raw, seed))
        yield damaged


@pytest.fixture
def damage() -> Damage:
    return damaged_copies
