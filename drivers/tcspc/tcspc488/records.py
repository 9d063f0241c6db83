"""The histogram records of a `tcspc488`: made by its firmware, read and checked by its driver.

Little-endian: u32 magic 'TC48', u32 point number, u64 ns since armed, u32 live us, u32 total counts, u32 sync counts,
u16 flags, u16 bins (0 for 65536), then one u16 or u32 per bin, then the CRC-32 of all that (docs/instruments.md).
"""

import struct
import zlib
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag

MAGIC = int.from_bytes(b"TC48", "little")
_HEADER = struct.Struct("<IIQIIIHH")
_CRC = struct.Struct("<I")
HEADER_BYTES = _HEADER.size
_KNOWN_FLAGS = 0x7F


def record_bytes(bins: int, wide: bool) -> int:
    """Length of a record: header, bins of two or four bytes, CRC."""
    return HEADER_BYTES + bins * (4 if wide else 2) + _CRC.size


class RecordHead(NamedTuple):
    """What a record says of its histogram, in the order in which it says it."""

    number: int
    opened_ns: int
    live_us: int
    total_count: int
    sync_count: int
    flags: int


def encode_record(head: RecordHead, counts: npt.NDArray[np.uint32], wide: bool) -> bytes:
    """One record. Counts above 65535 saturate in the narrow format, and the flag says so."""
    flags = head.flags
    if wide:
        payload = counts.astype("<u4", copy=False).tobytes()
    else:
        if counts.size and counts.max() > 0xFFFF:
            flags |= HistogramFlag.SATURATED
        payload = np.minimum(counts, 0xFFFF).astype("<u2").tobytes()
    begin = _HEADER.pack(MAGIC, *head[:-1], flags & _KNOWN_FLAGS, counts.size & 0xFFFF)
    return b"".join((begin, payload, _CRC.pack(zlib.crc32(payload, zlib.crc32(begin)))))


def decode_record(record: memoryview, number: int, axis: HistogramAxis, wide: bool) -> Histogram:
    """The histogram of point `number` in `record`.

    Raises ValueError where length, magic, checksum, bins, flags or number are not what they must be.
    """
    size = record_bytes(axis.bins, wide)
    if len(record) != size:
        raise ValueError(f"record of {len(record)} bytes; {axis.bins} bins make {size}")
    magic, *held, bins = _HEADER.unpack_from(record)
    head = RecordHead(*held)
    if magic != MAGIC:
        raise ValueError(f"record begins with {magic:#010x} instead of 'TC48'")
    (checksum,) = _CRC.unpack_from(record, size - _CRC.size)
    if zlib.crc32(record[: size - _CRC.size]) != checksum:
        raise ValueError("checksum of the record is wrong")
    if bins != axis.bins & 0xFFFF:
        raise ValueError(f"record has {bins} bins instead of {axis.bins}")
    if head.number != number:
        raise ValueError(f"record is that of point {head.number} instead of {number}")
    if head.flags & ~_KNOWN_FLAGS:
        raise ValueError(f"record has unknown flags {head.flags:#06x}")
    counts = np.frombuffer(record, "<u4" if wide else "<u2", axis.bins, HEADER_BYTES).astype(np.uint32)
    counts.flags.writeable = False
    flags = HistogramFlag(head.flags)
    if counts.max(initial=0) == (0xFFFFFFFF if wide else 0xFFFF):  # whatever the instrument says of it
        flags |= HistogramFlag.SATURATED
    return Histogram(
        counts, axis.bin_width_s, axis.offset_s, head.live_us * 1e-6, head.sync_count, head.total_count,
        flags, head.opened_ns * 1e-9,
    )  # fmt: skip


def missing_histogram(axis: HistogramAxis, flags: HistogramFlag) -> Histogram:
    """Stands for a point whose photons are lost: no counts, no live time."""
    return Histogram(np.zeros(axis.bins, np.uint32), axis.bin_width_s, axis.offset_s, 0.0, 0, 0, flags, float("nan"))
