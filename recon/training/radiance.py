"""Radiance HDR pictures (RGBE), flat or run-length coded: read to float32, with every length checked.

Format: Greg Ward, "Real Pixels", Graphics Gems II; the "new" run-length coding of Radiance's color.c.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

MAX_PIXELS = 1 << 28
CODED_WIDTHS = range(8, 32768)


def read_radiance(path: Path) -> npt.NDArray[np.float32]:
    """(rows, cols, 3), red, green, blue. Raises ValueError for anything that is not a whole picture."""
    data = path.read_bytes()
    header, _, rest = data.partition(b"\n\n")
    if not header.startswith((b"#?RADIANCE", b"#?RGBE")) or b"FORMAT=32-bit_rle_rgbe" not in header:
        raise ValueError(f"{path} is not a Radiance RGBE picture")
    size, _, pixels = rest.partition(b"\n")
    words = size.split()
    if len(words) != 4 or words[0] != b"-Y" or words[2] != b"+X" or not (words[1] + words[3]).isdigit():
        raise ValueError(f"{path}: orientation {size[:40]!r} is not read here; only -Y rows +X cols is")
    rows, cols = int(words[1]), int(words[3])
    if not 0 < rows * cols <= MAX_PIXELS:
        raise ValueError(f"{path}: {rows} x {cols} pixels")
    coded = cols in CODED_WIDTHS and pixels[:4] == bytes((2, 2, cols >> 8, cols & 255))
    rgbe = _coded(pixels, rows, cols, path) if coded else _flat(pixels, rows, cols, path)
    scale = np.ldexp(np.float32(1), rgbe[..., 3].astype(np.int32) - 136)
    return np.asarray(rgbe[..., :3] * np.where(rgbe[..., 3] > 0, scale, 0)[..., None], dtype=np.float32)


def _flat(data: bytes, rows: int, cols: int, path: Path) -> npt.NDArray[np.uint8]:
    if len(data) < 4 * rows * cols:
        raise ValueError(f"{path} ends after {len(data)} of {4 * rows * cols} bytes")
    return np.frombuffer(data, np.uint8, 4 * rows * cols).reshape(rows, cols, 4)


def _coded(data: bytes, rows: int, cols: int, path: Path) -> npt.NDArray[np.uint8]:
    out = np.empty((rows, 4, cols), np.uint8)
    view = out.reshape(-1)
    start, filled, line = bytes((2, 2, cols >> 8, cols & 255)), 0, 4 * cols
    at = 0
    for row in range(rows):
        if data[at : at + 4] != start:
            raise ValueError(f"{path}: row {row} does not begin as a coded row does, or is missing")
        at += 4
        end = filled + line
        while filled < end:
            if at + 1 >= len(data):
                raise ValueError(f"{path} ends within row {row} of {rows}")
            count = data[at]
            run = count > 128
            count = count - 128 if run else count
            piece = data[at + 1 : at + 2] * count if run else data[at + 1 : at + 1 + count]
            room = cols - filled % cols  # a run may not cross into the next channel
            if count == 0 or count > room or len(piece) < count:
                raise ValueError(f"{path}: row {row} holds a run of {count} where {room} fit, or is cut short")
            view[filled : filled + count] = np.frombuffer(piece, np.uint8)
            filled += count
            at += 2 if run else 1 + count
    return out.transpose(0, 2, 1)
