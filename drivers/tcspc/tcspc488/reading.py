"""Reading `tcspc488` records in pieces small enough for a link that must stay free for a shutter command.

Records are indexed, so asking twice is harmless: a damaged one is asked for once more, and then is its point's loss.
"""

from collections.abc import Callable, Sequence

from nlos.drivers.link.repeats import repeated
from nlos.drivers.link.usb488 import MOST_PER_TRANSFER
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag
from nlos.drivers.tcspc.tcspc488.records import decode_record, missing_histogram, record_bytes

Fetch = Callable[[int, int], memoryview | None]
"""(first point, how many) -> their records in one block; None where they were overwritten."""
_AROUND_BLOCK = 256


def read_records(
    fetch: Fetch, numbers: Sequence[int], first: int, count: int, axis: HistogramAxis, wide: bool
) -> list[Histogram]:
    """The histograms of points `first`..; those lost or damaged twice are empty and flagged `DATA_LOST`."""
    most = max(1, (MOST_PER_TRANSFER - _AROUND_BLOCK) // record_bytes(axis.bins, wide))
    histograms: list[Histogram] = []
    for start in range(first, first + count, most):
        histograms += _read_block(fetch, numbers, start, min(most, first + count - start), axis, wide)
    return histograms


def _read_block(
    fetch: Fetch, numbers: Sequence[int], first: int, count: int, axis: HistogramAxis, wide: bool
) -> list[Histogram]:
    size = record_bytes(axis.bins, wide)
    block = fetch(first, count)
    if block is None:
        if count == 1:
            return [missing_histogram(axis, HistogramFlag.DATA_LOST | HistogramFlag.OVERRUN)]
        return [each for k in range(count) for each in _read_block(fetch, numbers, first + k, 1, axis, wide)]
    return [checked(fetch, block[k * size : (k + 1) * size], numbers, first + k, axis, wide) for k in range(count)]


def checked(
    fetch: Fetch, record: memoryview, numbers: Sequence[int], index: int, axis: HistogramAxis, wide: bool
) -> Histogram:
    """The histogram in `record`, or in a second copy of it, or none."""
    try:
        return decode_record(record, numbers[index], axis, wide)
    except ValueError as problem:
        repeated("tcspc488", problem)
        block = fetch(index, 1)
    try:
        if block is not None:
            return decode_record(block, numbers[index], axis, wide)
    except ValueError:
        pass
    return missing_histogram(axis, HistogramFlag.DATA_LOST)
