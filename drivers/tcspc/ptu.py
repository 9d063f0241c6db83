"""PTU files: the header's tags, and the T3 records behind it for the same decoder that serves a live counter.

Layout: PicoQuant's "Unified TTTR file format"; section 3.3 of docs/instruments.md.
"""

import struct
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.drivers.errors import DataCorrupt
from nlos.drivers.tcspc.t3 import FORMATS, T3Format

Tag = bool | int | float | str | bytes

_TAG = struct.Struct("<32siI8s")
_MOST_TAGS = 10_000
_MOST_VALUE_BYTES = 64 << 20


@dataclass(frozen=True)
class PtuRecords:
    """A T3 measurement: tags (with `[i]` after the name of indexed ones), and the records as they were written."""

    tags: dict[str, Tag]
    layout: T3Format
    pulse_s: float
    """Time between two laser pulses."""
    bin_width_s: float
    records: npt.NDArray[np.uint32]  # (n,)
    truncated: bool
    """The file ends before the number of records that its header states."""


def read_ptu(path: Path) -> PtuRecords:
    """Reads a T3 file whole. Raises `DataCorrupt` where it is not one."""
    data = path.read_bytes()
    tags, start = decode_tags(data, path.name)
    mode = _number(tags, "Measurement_Mode", path.name)
    kind = int(_number(tags, "TTResultFormat_TTTRRecType", path.name))
    layout = FORMATS.get(kind)
    if mode != 3 or layout is None:
        raise DataCorrupt(path.name, f"is a measurement of mode {mode} with records of type {kind:#x}, not T3.")
    stated = int(_number(tags, "TTResult_NumberOfRecords", path.name))
    there = (len(data) - start) // 4
    pulse_s = _number(tags, "MeasDesc_GlobalResolution", path.name)
    bin_width_s = _number(tags, "MeasDesc_Resolution", path.name)
    if stated < 0 or not (0 < pulse_s < 1 and 0 < bin_width_s < 1):
        raise DataCorrupt(path.name, f"states {stated} records, pulses {pulse_s:g} s and bins {bin_width_s:g} s.")
    records = np.frombuffer(data, "<u4", min(stated, there), start)
    return PtuRecords(tags, layout, pulse_s, bin_width_s, records, there < stated)


def decode_tags(data: bytes, name: str) -> tuple[dict[str, Tag], int]:
    """The tags, and where the records begin. Raises `DataCorrupt`."""
    if data[:6] != b"PQTTTR":
        raise DataCorrupt(name, f"begins with {data[:8]!r}, not as a PTU file.")
    tags: dict[str, Tag] = {}
    at = 16
    for _ in range(_MOST_TAGS):
        if at + _TAG.size > len(data):
            break
        raw_name, index, kind, value = _TAG.unpack_from(data, at)
        at += _TAG.size
        ident = raw_name.rstrip(b"\0").decode("ascii", "replace")
        if ident == "Header_End":
            return tags, at
        extra = b""
        if kind in (0x2001FFFF, 0x4001FFFF, 0x4002FFFF, 0xFFFFFFFF):
            length = int.from_bytes(value, "little", signed=True)
            if not 0 <= length <= min(_MOST_VALUE_BYTES, len(data) - at):
                raise DataCorrupt(name, f"tag {ident} states {length} bytes.")
            extra, at = data[at : at + length], at + length
        tags[ident if index < 0 else f"{ident}[{index}]"] = _decode_value(kind, value, extra, ident, name)
    raise DataCorrupt(name, "the header does not end.")


def _decode_value(kind: int, value: bytes, extra: bytes, ident: str, name: str) -> Tag:
    match kind:
        case 0xFFFF0008:
            return b""
        case 0x00000008:
            return any(value)
        case 0x10000008 | 0x11000008 | 0x12000008:
            return int.from_bytes(value, "little", signed=True)
        case 0x20000008 | 0x21000008:
            return float(struct.unpack("<d", value)[0])
        case 0x4001FFFF:
            return extra.rstrip(b"\0").decode("latin-1")
        case 0x4002FFFF:
            return extra.decode("utf-16-le", "replace").rstrip("\0")
        case 0x2001FFFF | 0xFFFFFFFF:
            return extra
    raise DataCorrupt(name, f"tag {ident} has the unknown type {kind:#x}.")


def _number(tags: dict[str, Tag], ident: str, name: str) -> float:
    value = tags.get(ident)
    if not isinstance(value, (int, float)) or not isfinite(value):
        raise DataCorrupt(name, f"lacks the tag {ident}, or it is not a number.")
    return float(value)
