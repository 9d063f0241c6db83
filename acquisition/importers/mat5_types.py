"""Whether an array in a MAT file of version 5 says a type of number that there is: SciPy 1.17 crashes on others.

Layout: "MAT-File Format", MathWorks, chapter 1. After a header of 128 bytes come elements, each behind a tag of type
and size; an array's flags, dimensions and name come before its numbers, whose tag is what is looked at.
"""

import struct
import zlib
from pathlib import Path

HEADER = 128
MATRIX, COMPRESSED = 14, 15
NUMERIC_CLASSES = range(6, 16)
NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})
"""miINT8 to miUINT64."""
LOOKED_AT = 1 << 16
"""Bytes of each array that its tags are looked for in."""


def no_number(path: Path, name: str) -> int | None:
    """The type that array `name` says its numbers have, if it is none of MATLAB's; else None, as for anything that is
    no whole file of version 5: whoever reads it will say so."""
    with path.open("rb") as file:
        header = file.read(HEADER)
        order = {b"IM": "<", b"MI": ">"}.get(header[126:128])
        while order and len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            start = file.tell()
            held = file.read(min(size, LOOKED_AT))
            if kind == COMPRESSED:
                try:
                    held = zlib.decompressobj().decompress(held, LOOKED_AT)[8:]
                except zlib.error:
                    return None
            if kind in (MATRIX, COMPRESSED) and (wrong := _type_in(held, order, name)) is not None:
                return wrong
            file.seek(start + size)
    return None


def _type_in(array: bytes, order: str, name: str) -> int | None:
    """Of one array behind its own tag."""
    parts, at = [], 0
    try:
        for _ in range(3):
            _, begin, end, at = _element(array, order, at)
            parts.append(array[begin:end])
        kind = _element(array, order, at)[0]
        numeric = struct.unpack(f"{order}I", parts[0][:4])[0] & 0xFF in NUMERIC_CLASSES
    except struct.error:
        return None
    ours = parts[2] == name.encode() and numeric
    return kind if ours and kind not in NUMBERS else None


def _element(array: bytes, order: str, at: int) -> tuple[int, int, int, int]:
    """Type of the element at `at`, where its bytes begin and end, and where the next one is."""
    (word,) = struct.unpack_from(f"{order}I", array, at)
    if word >> 16:  # up to four bytes lie in the tag
        return word & 0xFFFF, at + 4, at + 4 + (word >> 16), at + 8
    (size,) = struct.unpack_from(f"{order}I", array, at + 4)
    return word, at + 8, at + 8 + size, at + 8 + (size + 7) // 8 * 8
