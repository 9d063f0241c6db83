"""PTU images put together record by record from PicoQuant's description of PicoHarp T3 files: rasters of any mirror."""

import struct
from pathlib import Path

import numpy as np

FRAME, PAUSE = 10, 500
"""Pulses between marks: frame and first line, line and line."""
INTEGER, FLAG, NUMBER, END = 0x10000008, 0x00000008, 0x20000008, 0xFFFF0008
LINE_START, LINE_STOP, FRAME_MARK = 1, 2, 3
SYNC_HZ, POINT_PULSES = 10_000_000, 2000


def write_raster(
    path: Path, shape: tuple[int, int], photons: np.ndarray, *, two_ways: bool = False, sine_percent: int = 0
) -> Path:
    """`photons` (P, 3): line, how far through the time of the line (0 to 1), delay in bins."""
    rows, cols = shape
    length = cols * POINT_PULSES
    begins = 1000 + FRAME + np.arange(rows) * (length + PAUSE)
    marks = [(1000, FRAME_MARK)] + [(at, LINE_START) for at in begins] + [(at + length, LINE_STOP) for at in begins]
    stream = [(int(at), 0, 15 << 28 | 1 << 16 + number - 1) for at, number in marks]
    stream += [(int(begins[int(line)] + part * length), 1, 1 << 28 | int(delay) << 16) for line, part, delay in photons]
    records, overflows = [], 0
    for at, _, record in sorted(stream):
        records += [0xF0000000] * ((at >> 16) - overflows)
        overflows = at >> 16
        records.append(record | at & 0xFFFF)
    said = {
        "Measurement_Mode": 3, "Measurement_SubMode": 3, "TTResultFormat_TTTRRecType": 0x00010303,
        "TTResultFormat_BitsPerRecord": 32, "TTResult_NumberOfRecords": len(records), "TTResult_SyncRate": SYNC_HZ,
        "ImgHdr_Dimensions": 3, "ImgHdr_Ident": 1, "ImgHdr_PixX": cols, "ImgHdr_PixY": rows,
        "ImgHdr_LineStart": LINE_START, "ImgHdr_LineStop": LINE_STOP, "ImgHdr_Frame": FRAME_MARK,
        "ImgHdr_SinCorrection": sine_percent,
    }  # fmt: skip
    tags = [_tag(name, INTEGER, struct.pack("<q", value)) for name, value in said.items()]
    tags.append(_tag("ImgHdr_BiDirect", FLAG, struct.pack("<q", -two_ways)))
    numbers = {"ImgHdr_TimePerPixel": POINT_PULSES / SYNC_HZ * 1e3, "MeasDesc_Resolution": 64e-12}
    numbers["MeasDesc_GlobalResolution"] = 1 / SYNC_HZ
    tags += [_tag(name, NUMBER, struct.pack("<d", value)) for name, value in numbers.items()]
    tags.append(_tag("Header_End", END, bytes(8)))
    path.write_bytes(b"PQTTTR\0\0" + b"1.0.00\0\0" + b"".join(tags) + np.array(records, "<u4").tobytes())
    return path


def _tag(name: str, kind: int, value: bytes) -> bytes:
    return struct.pack("<32siI", name.encode(), -1, kind) + value
