"""SDT files of Becker & Hickl, put together byte by byte from the vendor's SPC_data_file_structure.h (SPCM 9.66)."""

import io
import struct
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

DECAY, PAGE, FCS, IMAGE = 0x00, 0x10, 0x20, 0x60
MEASURED, FIFO = 1, 8
LONG, ZIPPED = 0x100, 0x1000
IDENTITY = {MEASURED: "SPC Setup & Data File", FIFO: "SPC FCS Data File"}
TAC_S, GAIN, COLLECTED_S, STOPPED_S = 5e-8, 4, 60.0, 48.0
"""Range and gain of the time-to-amplitude converter; how long was meant to be counted, and was."""

_MEASURE_INFO = (  # packed; what follows is zero
    ("time", "9s", b"12:00:00"), ("date", "11s", b"11-23-2026"), ("mod_ser_no", "16s", b"3E0117"),
    ("meas_mode", "h", 9), ("cfd", "4f", (-50.0, 80.0, 0.0, 5.0)), ("syn", "f h f", (0.0, 1, 4.0)),
    ("tac_r", "f", TAC_S), ("tac_g", "h", GAIN), ("tac", "3f", (5.0, 10.0, 90.0)), ("adc_re", "h", 0),
    ("eal_de", "h", 0), ("nc", "2h", (1, 1)), ("page", "H", 1), ("col_t", "f", COLLECTED_S), ("rep_t", "f", 60.0),
    ("stopt", "h", 1), ("overfl", "c", b"N"), ("use_motor", "h", 0), ("steps", "H", 1), ("offset", "f", 0.0),
    ("dither", "h", 0), ("incr", "h", 1), ("mem_bank", "h", 0), ("mod_type", "16s", b"SPC-150"), ("syn_th", "f", -20.0),
    ("dead_time_comp", "h", 1), ("polarity", "3h", (0, 0, 0)), ("linediv", "h", 0), ("accumulate", "h", 0),
    ("flbck", "2i", (0, 0)), ("bord", "2i", (0, 0)), ("pix_time", "f", 1e-6), ("pix_clk", "h", 1), ("trigger", "h", 0),
    ("scan_x", "i", 0), ("scan_y", "i", 0), ("scan_rx", "i", 1), ("scan_ry", "i", 1), ("fifo_typ", "h", 0),
    ("epx_div", "i", 1), ("mod_type_code", "H", 0x28), ("mod_fpga_ver", "H", 0x300), ("overflow_corr", "f", -1.0),
    ("adc_zoom", "i", 0), ("cycles", "i", 1),
    ("stop_flags", "2H", (0, 7)), ("stop_time", "f", STOPPED_S), ("stop_at", "3i", (1, 1, 1)),
    ("stop_rates", "8f", (-1.0,) * 8), ("stop_reserved", "i f", (0, 0.0)),
    ("fcs", "2H I f I i f 4H H I", (0, 0, 500, 0.0, 0, 0, 0.0, 0, 0, 0, 0, 0, 0)),
    ("image_x", "i", 0), ("image_y", "i", 0), ("image_rx", "i", 1), ("image_ry", "i", 1),
)  # fmt: skip


def measure_info(**said: Any) -> bytes:
    """One measurement description block of 512 bytes."""
    packed = b"".join(
        struct.pack(f"<{layout}", *(value if isinstance(value, tuple) else (value,)))
        for name, layout, default in _MEASURE_INFO
        for value in (said.get(name, default),)
    )
    return packed.ljust(512, b"\0")


def write_sdt(
    path: Path, blocks: Sequence[np.ndarray], kind: int = PAGE, mode: int = MEASURED, *, zipped: bool = False,
    old: bool = False, word: bool = False, said: dict[str, Any] | None = None,
) -> Path:  # fmt: skip
    """A file with these blocks of counts (..., T), whose images are (H, W, T). `old`: with the shorter block numbers
    of software before revision 15. `word`: its check word is 0x55AA itself; SPCM makes the
    sum of all words that."""
    bins = blocks[0].shape[-1]
    place = {}
    if blocks[0].ndim == 3:
        rows, cols = blocks[0].shape[:2]
        place = {"image_x": cols, "image_y": rows} if kind == IMAGE else {"scan_x": cols, "scan_y": rows}
    about = measure_info(**{"adc_re": bins, "meas_mode": 13 if kind == IMAGE else 9, **place, **(said or {})})
    info = (
        f"*IDENTIFICATION\r\n  ID        : \x04{IDENTITY[mode]}\x04\r\n  Title     : a wall\r\n"
        "  Version   : 3  985 M\r\n  Revision  : 10 bits ADC\r\n  Date      : 11-23-2026\r\n  Time      : 12:00:00\r\n"
        "  Author    : Unknown\r\n  Company   : Unknown\r\n  Contents  : a scan\r\n*END\r\n\r\n"
    ).encode("ascii")
    sizes = "".join(f"  #SP [SP_{name.upper()},I,{value}]\r\n" for name, value in place.items())
    sizes = sizes.replace("IMAGE", "IMG") + f"  #SP [SP_ADC_RE,I,{bins}]\r\n"
    setup = f"*SETUP\r\n  SYS_PARA_BEGIN:\r\n{sizes}  SYS_PARA_END:\r\n*END\r\n".encode("ascii")
    setup_at = 42 + len(info)
    about_at = setup_at + len(setup)
    at = data_at = about_at + len(about)
    body = b""
    for number, block in enumerate(blocks):
        data = np.ascontiguousarray(block, "<u4" if block.dtype.itemsize == 4 else "<u2")
        stored = _zipped(data.tobytes()) if zipped else data.tobytes()
        form = kind | mode | (LONG if data.itemsize == 4 else 0) | (ZIPPED if zipped else 0)
        follows = at + 22 + len(stored)
        last = follows if number + 1 < len(blocks) else 0
        start = struct.pack("<h i i", number, at + 22, last) if old else struct.pack("<2B 2I", 0, 0, at + 22, last)
        if zipped:  # where a zipped block ends is told by where the next one begins
            start = (
                struct.pack("<h i i", number, at + 22, follows)
                if old
                else struct.pack("<2B 2I", 0, 0, at + 22, follows)
            )
        body += start + struct.pack("<H h 2I", form, 0, number + 1, data.nbytes) + stored
        at = follows
    head = struct.pack(
        "<h i h i H i h I i h h H I H H", 0x280 | (12 if old else 15), 42, len(info), setup_at, len(setup), data_at,
        len(blocks), max(block.nbytes for block in blocks), about_at, 1, len(about), 0x5555, len(blocks), 0,
        0x55AA if word else 0,
    )  # fmt: skip
    if not word:
        rest = sum(struct.unpack("<21H", head)) & 0xFFFF
        head = head[:-2] + struct.pack("<H", (0x55AA - rest) & 0xFFFF)
    path.write_bytes(head + info + setup + about + body)
    return path


def _zipped(data: bytes) -> bytes:
    stored = io.BytesIO()
    with zipfile.ZipFile(stored, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data_block", data)
    return stored.getvalue()
