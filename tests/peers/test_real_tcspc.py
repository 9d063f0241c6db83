"""Files of real instruments, from other people's repositories: every bin as they hold it, by readers that share nothing
with ours."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.importers.formats import read_any

Counts = npt.NDArray[np.int64]


def blocks_of_sdt(path: Path) -> list[Counts]:
    """The blocks of an unzipped SDT file, flat, by offsets of the vendor's SPC_data_file_structure.h alone."""
    raw = path.read_bytes()
    at, count = struct.unpack_from("<ih", raw, 14)
    found = []
    for _ in range(count):
        data_at, next_at, kind, _, _, length = struct.unpack_from("<2IHh2I", raw, at + 2)
        assert not kind & 0x1000, "zipped"
        found.append(
            np.frombuffer(raw, "<u4" if kind & 0x100 else "<u2", length // (4 if kind & 0x100 else 2), data_at)
        )
        at = next_at
    return [each.astype(np.int64) for each in found]


@pytest.mark.parametrize("name", ["FLIM.sdt", "temporal.sdt"])
def test_sdt_files_of_spcm(checkout: Callable[..., Path], name: str) -> None:
    path = next(checkout("pyglotaran").rglob(name))
    counts = np.moveaxis(read_any(path).transient.counts, 0, 2).astype(np.int64)
    (stored,) = blocks_of_sdt(path)
    assert stored.sum() > 1e5
    assert np.array_equal(counts.ravel(), stored)


def test_a_timeharps_histograms_are_the_same_in_both_versions_of_their_file(checkout: Callable[..., Path]) -> None:
    """libpicoquant has one measurement in format 2.0 and in 6.0, by the vendor's software."""
    folder = checkout("libpicoquant")
    old, new = (
        read_any(next(path for path in folder.rglob("*.thd") if path.read_bytes()[16:19] == version)).transient
        for version in (b"2.0", b"6.0")
    )
    assert old.counts.sum() > 1e7
    assert np.array_equal(old.counts, new.counts)
    assert old.exposure_s == pytest.approx(new.exposure_s)
    assert old.exposure_s.ravel() == pytest.approx([2.69, 22.47, 179.72, 127.97, 1.54])
