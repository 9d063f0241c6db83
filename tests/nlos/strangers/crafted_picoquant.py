"""PicoQuant files that somebody made: every number of a header at its extremes, every tag as every other type, lists of
tags without an end, other instruments' records, records past the end, and what a scan never wrote."""

import struct
from collections.abc import Iterator

import numpy as np

HEADER_END = b"Header_End".ljust(32, b"\0")
IMAGE = ("ImgHdr_Dimensions", "ImgHdr_PixX", "ImgHdr_PixY", "ImgHdr_LineStart", "ImgHdr_LineStop", "ImgHdr_Frame",
         "ImgHdr_Ident", "ImgHdr_BiDirect", "ImgHdr_SinCorrection", "ImgHdr_MaxFrames")  # fmt: skip
INTEGERS = (0, -1, 1, 700, 2**31, 2**62)
REALS = (0.0, -1.0, float("nan"), float("inf"), 1e300, 1e-300)
_INT, _FLOAT, _END = 0x10000008, 0x20000008, 0xFFFF0008
_FLOATS, _TEXT, _WIDE, _BLOB = 0x2001FFFF, 0x4001FFFF, 0x4002FFFF, 0xFFFFFFFF
LONG = (_FLOATS, _TEXT, _WIDE, _BLOB)
"""Tags whose value is a number of bytes that follow."""
TYPES = (_END, 0x00000008, _INT, 0x11000008, 0x12000008, _FLOAT, 0x21000008, *LONG, 0x31000008)
"""Every type that there is, and one that there is not."""
RECORDS = {
    name: code | minor
    for name, code in (("PicoHarp", 0x00010000), ("HydraHarp", 0x00010004), ("TimeHarp 260N", 0x00010005),
                       ("TimeHarp 260P", 0x00010006), ("generic", 0x00010007), ("HydraHarp 2", 0x01010004), ("none", 7))
    for minor in (0x200, 0x300)
}  # fmt: skip
LENGTHS = (-1, 3, 7, 4096, 2**31, 2**62)


def tags(raw: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Where each 48-byte tag of a PTU's header begins, its name and its type (PicoQuant's Unified TTTR format)."""
    at = 16
    while raw[at : at + 32] != HEADER_END:
        kind, value = struct.unpack_from("<Iq", raw, at + 36)
        yield at, raw[at : at + 32].rstrip(b"\0"), kind
        at += 48 + (value if kind in LONG else 0)


def tag(name: str, value: int | float, kind: int | None = None, index: int = -1) -> bytes:
    """One tag; an integer's or a real's by what it is given."""
    number = struct.pack("<d", value) if isinstance(value, float) else struct.pack("<q", value)
    chosen = kind if kind is not None else _FLOAT if isinstance(value, float) else _INT
    return name.encode().ljust(32, b"\0") + struct.pack("<iI", index, chosen) + number


def numbers(raw: bytes) -> Iterator[tuple[str, bytes]]:
    """Each number of the header at each extreme; then the tags of an image scanned before 2014, in every state."""
    for at, name, kind in tags(raw):
        values = [struct.pack("<q", v) for v in INTEGERS] if kind == _INT else [struct.pack("<d", v) for v in REALS]
        for value in values if kind in (_INT, _FLOAT) else []:
            yield f"{name.decode()} {value.hex()}", raw[: at + 40] + value + raw[at + 48 :]
    end = raw.index(HEADER_END)
    for name in IMAGE:
        for number in INTEGERS:
            rest = [(other, 1 if other != "ImgHdr_Dimensions" else 3) for other in IMAGE if other != name]
            made = b"".join(tag(each, value) for each, value in [*rest, (name, number)])
            yield f"image with {name} {number}", raw[:end] + made + raw[end:]


def types(raw: bytes) -> Iterator[tuple[str, bytes]]:
    """Each tag as each type, with its own value and as a text of every length; each one missing, and each twice."""
    for at, name, kind in tags(raw):
        size = 48 + (struct.unpack_from("<q", raw, at + 40)[0] if kind in LONG else 0)
        for other in TYPES:
            yield f"{name.decode()} as {other:08x}", raw[: at + 36] + struct.pack("<I", other) + raw[at + 40 :]
        for length in LENGTHS:
            made = tag(name.decode(), length, _TEXT) + b"x" * min(max(length, 0), 8192)
            yield f"{name.decode()} a text of {length}", raw[:at] + made + raw[at + size :]
        yield f"without {name.decode()}", raw[:at] + raw[at + size :]
        again = raw[at : at + 32] + struct.pack("<i", 2**30) + raw[at + 36 : at + size]
        yield f"{name.decode()} again, far on", raw[:at] + again + raw[at:]
        yield f"cut at {name.decode()}", raw[: at + 20]


def lists(raw: bytes) -> Iterator[tuple[str, bytes]]:
    """Tag lists that do not end, end too early, or are long; files of other vendors and versions under this name."""
    end = raw.index(HEADER_END)
    for length in (0, 6, 8, 15, 16, 40, end, end + 48, end + 50):
        yield f"cut at {length}", raw[:length]
    yield "no end", raw[:end] + raw[end + 48 :]
    yield "an end first", raw[:16] + raw[end : end + 48] + raw[16:]
    yield "100,000 tags more", raw[:end] + b"".join(tag(f"x{n}", n) for n in range(100_000)) + raw[end:]
    yield "one tag 100,000 times", raw[:end] + tag("UsrHeadName", 1) * 100_000 + raw[end:]
    yield "an array of 1000 places", raw[:end] + b"".join(tag("ar", n, index=n) for n in range(1000)) + raw[end:]
    for magic in (b"PQTTTR\0\0", b"PQHISTO\0", b"PQDCYS\0\0", b"PQUNIF\0\0", b"PQCOLOR\0", b"pqtttr\0\0", b"\0" * 8):
        yield f"begins with {magic!r}", magic + raw[8:]
    for version in (b"0.0.00\0\0", b"9.9.99\0\0", b"\xff" * 8, b"\0" * 8):
        yield f"version {version!r}", raw[:8] + version + raw[16:]
    yield from OTHERS.items()


OTHERS = {
    "an SDT file of Becker & Hickl": struct.pack("<h l h l l h l h h h H H H", 0x5555, 42, 200, 300, 4200, 1, 500, 512,
                                                 1, 512, 0x5555, 0, 0) + bytes(9000),
    "an SPC file of Becker & Hickl": struct.pack("<I", 0x10 << 24 | 500) * 4000,
    "a tag stream of Swabian": b"SITT" + bytes(range(256)) * 30,
    "a picture": b"\x89PNG\r\n\x1a\n" + bytes(3000),
    "an archive": b"PK\x03\x04" + bytes(3000),
}  # fmt: skip


def _told(raw: bytes, name: str, value: int) -> bytes:
    """The file, with this number instead of the tag's own."""
    at = next(at for at, other, _ in tags(raw) if other.decode() == name)
    return raw[: at + 40] + struct.pack("<q", value) + raw[at + 48 :]


def records(raw: bytes) -> Iterator[tuple[str, bytes]]:
    """Every kind of record in each mode, and what no instrument writes: overflows alone, marks alone, noise."""
    for name, code in RECORDS.items():
        for mode in (2, 3):
            made = _told(raw, "TTResultFormat_TTTRRecType", code)
            yield f"{name} {code:08x} as T{mode}", _told(made, "Measurement_Mode", mode)
    head, count = raw[: raw.index(HEADER_END) + 48], 50_000
    noise = np.random.default_rng(0).integers(0, 2**32, count, np.uint32)
    for name, words in {
        "nothing": noise[:0], "zeros": np.zeros(count, np.uint32), "ones": np.full(count, 0xFFFFFFFF, np.uint32),
        "overflows of 1023": np.full(count, 0xFE0003FF, np.uint32),
        "overflows of 0": np.full(count, 0xFE000000, np.uint32),
        "marks alone": np.uint32(0x80000000) | (np.arange(count, dtype=np.uint32) % 63 + 1) << 25,
        "photons alone": np.arange(count, dtype=np.uint32) & 0x3FFFFFF, "noise": noise,
        "marks backwards": np.uint32(0x84000000) | np.arange(1023, -1, -1, dtype=np.uint32),
    }.items():  # fmt: skip
        for stated in (len(words), len(words) // 2, 10 * count, 2**40, -1):
            yield f"{name}, {stated} stated", _told(head, "TTResult_NumberOfRecords", stated) + words.tobytes()
    yield "half a record at the end", raw[:-2]
    yield "bytes after the last record", raw + b"\xff" * 1001


def older(raw: bytes, head_bytes: int = 1024) -> Iterator[tuple[str, bytes]]:
    """A file from before PTU with every fourth byte's number of its header at extremes."""
    for at in range(0, min(head_bytes, len(raw) - 4), 4):
        for word in (0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 0x7FC00000, 0xFF800000, 0x80000000):
            yield f"{word:08x} at {at}", raw[:at] + struct.pack("<I", word) + raw[at + 4 :]
    for length in (0, 16, 300, 328, 700, 800, len(raw) - 3):
        yield f"cut at {length}", raw[:length]
