"""Becker & Hickl SDT files, decoded by `sdtfile` (C. Gohlke): images of scan points, and curves as a row of points.

What the blocks mean: W. Becker, "The bh TCSPC Handbook", and the vendor's SPC_data_file_structure.h. FIFO streams (SPC)
hold photons without a description of the scan, and are refused by name.
"""

import math
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.detectors import added_up, one_alone
from nlos.acquisition.importers.given import NOTHING, Given, put_there
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.raw_histograms import raw_scan
from nlos.acquisition.importers.untrusted_hdf5 import MAX_BYTES

if TYPE_CHECKING:
    from sdtfile import SdtFile

_HEADER = struct.Struct("<h i h i H i h I i h h H I H H")  # bhfile_header, packed
_WORDS = struct.Struct(f"<{_HEADER.size // 2}H")
_VALID, _UNFINISHED, _CHECK_SUM = 0x5555, 0x1111, 0x55AA
"""The check sum is that of all of the header's words, modulo 2^16; some software wrote it in place of its last word."""
_HISTOGRAMS = ("DECAY_BLOCK", "PAGE_BLOCK", "IMG_BLOCK")
"""Kinds of blocks that hold counts by delay."""
_DAMAGE = (
    ValueError, LookupError, TypeError, ArithmeticError, AssertionError, AttributeError, EOFError, OSError,
    MemoryError, RuntimeError, struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What `sdtfile` raises where a file is not as it should be."""


@dataclass(frozen=True)
class _Block:
    """One data block of histograms."""

    counts: npt.NDArray[Any]  # (..., T)
    bin_width_s: float
    """0 where the file does not say."""
    measured_s: float
    """How long was counted; 0 where the file does not say."""


def is_sdt(path: Path) -> bool:
    """Whether a file begins with an SDT file's header, whatever it is called."""
    return _mark(path) is not None


def _mark(path: Path) -> int | None:
    """Whether an SDT file was finished (`_VALID`, `_UNFINISHED`); None for other files."""
    with path.open("rb") as file:
        head = file.read(_HEADER.size)
    if len(head) < _HEADER.size:
        return None
    _, texts_at, *_, valid, _, _, check = _HEADER.unpack(head)
    if valid == _UNFINISHED and texts_at == _HEADER.size:  # the check sum comes last
        return _UNFINISHED
    return _VALID if valid == _VALID and _CHECK_SUM in (check, sum(_WORDS.unpack(head)) % (1 << 16)) else None


def read_sdt(path: Path, given: Given = NOTHING) -> ImportedScan:
    """Reads an SDT file as a scan: an image, or curves as a row of points. Raises `InvalidData` naming file and
    reason."""
    if path.stat().st_size > MAX_BYTES:
        raise InvalidData(f"{path}: is {path.stat().st_size / 2**30:.1f} GiB; at most {MAX_BYTES >> 30} GiB are read")
    if (mark := _mark(path)) is None:
        raise InvalidData(
            f"{path}: does not begin as an SDT file of Becker & Hickl (mark and check sum of its header). Is it one, "
            "and the copy complete?"
        )
    if mark == _UNFINISHED:
        raise InvalidData(f"{path}: says that it was never finished. Save it again from SPCM.")
    with _opened(path) as sdt:
        blocks, others = _blocks(path, sdt)
    if not blocks:
        raise InvalidData(
            f"{path}: holds no histograms of delays, but {', '.join(sorted(others)) or 'nothing'}. "
            "Save the decay curves or the FLIM image from SPCM."
        )
    widths = {block.bin_width_s for block in blocks}
    if len(widths) > 1:
        listed = ", ".join(f"{width * 1e12:g}" for width in sorted(widths))
        raise InvalidData(
            f"{path}: its blocks have bins of different widths ({listed} ps). Save one measurement a file."
        )
    said_s = widths.pop()
    width_s = given.bin_width_s or said_s
    if not width_s > 0:
        raise InvalidData(f"{path}: does not say its time axis (TAC range and gain). {put_there('--bin-width-ps PS')}")
    images = [block for block in blocks if block.counts.ndim > 2]
    if images and len(images) < len(blocks):
        raise InvalidData(f"{path}: holds images and curves. Save one measurement a file.")
    counts, exposure_s, notes = _image(path, images, given.detector) if images else _row(path, blocks)
    notes += given.other_bins(said_s or None)
    if others:
        notes.append(f"blocks of other kinds are not imported: {', '.join(sorted(others))}")
    return raw_scan(counts, exposure_s, width_s, f"SDT {'image' if images else 'curves'}", tuple(notes), str(path))


def contents_of_sdt(path: Path) -> dict[str, object]:
    """What is in an SDT file, by name, for people. Raises `InvalidData` for a damaged one."""
    from sdtfile import BlockType, FileRevision

    with _opened(path) as sdt:
        blocks = [
            f"{BlockType(int(header.block_type)).contents} {data.shape}"
            for header, data in zip(sdt.block_headers, sdt.data, strict=True)
        ]
        return {
            "format": f"SDT, {sdt.info.id.strip(chr(4))}",
            "instrument": FileRevision(int(sdt.header.revision)).module,
            "blocks": ", ".join(blocks[:32]) or "none",
        }


@contextmanager
def _opened(path: Path) -> "Iterator[SdtFile]":
    """The file, decoded. Raises `InvalidData` where it is not as it should be, also inside the block."""
    from sdtfile import SdtFile  # here, so that whoever reads other formats does not load it

    try:
        with SdtFile(path) as sdt:
            yield sdt
    except _DAMAGE as error:
        if isinstance(error, InvalidData):
            raise
        said = f"{type(error).__name__}: {error}".rstrip(": ")
        raise InvalidData(
            f"{path}: not a readable SDT file, or one that is cut off. Copy it again. ({said})"
        ) from error


def _blocks(path: Path, sdt: "SdtFile") -> tuple[list[_Block], set[str]]:
    """The blocks of histograms, and what the others are called. Raises `InvalidData` for blocks that are cut short."""
    from sdtfile import BlockType

    blocks, others = [], set()
    for number, (header, data) in enumerate(zip(sdt.block_headers, sdt.data, strict=True)):
        names = header.dtype.names or ()
        if any(int(header[name]) for name in ("data_offs_ext", "next_block_offs_ext") if name in names):
            raise InvalidData(f"{path}: block {number}: lies beyond 4 GiB, which is not read")
        kind = BlockType(int(header.block_type))
        if data.nbytes != int(header.block_length) // kind.dtype.itemsize * kind.dtype.itemsize:
            raise InvalidData(f"{path}: block {number}: states {header.block_length} bytes and holds {data.nbytes}")
        if kind.contents not in _HISTOGRAMS:
            others.add(kind.contents)
            continue
        measured = sdt.block_measure_info(number)
        blocks.append(_Block(data, _bin_width_s(measured, data.shape[-1]), _measured_s(measured)))
    return blocks, others


def _bin_width_s(measured: Any, bins: int) -> float:
    """The range of the time-to-amplitude converter, over its gain and the bins; 0 where the file does not say."""
    gain, range_s = int(measured.tac_g), float(measured.tac_r)
    return range_s / (gain * bins) if gain > 0 and math.isfinite(range_s) and range_s > 0 else 0.0


def _measured_s(measured: Any) -> float:
    """How long was counted, as the measurement's end tells it, else as it was meant to last."""
    names = measured.dtype.names or ()
    stopped = float(measured.StopInfo.stop_time) if "StopInfo" in names else 0.0
    meant = float(measured.col_t) if "col_t" in names else 0.0
    return next((value for value in (stopped, meant) if math.isfinite(value) and value > 0), 0.0)


def _image(
    path: Path, images: list[_Block], wanted: int | None
) -> tuple[npt.NDArray[Any], npt.NDArray[np.float64], list[str]]:
    """Counts (H, W, T) over all detectors, or of the image that is `wanted`, exposures (H, W), and what was assumed."""
    shape = images[0].counts.shape[-3:]
    if any(image.counts.shape[-3:] != shape for image in images):
        listed = ", ".join(str(image.counts.shape) for image in images)
        raise InvalidData(f"{path}: holds images of different shapes ({listed}). Save one measurement a file.")
    rows, cols, bins = shape
    if rows * cols * bins * 4 > MAX_BYTES:
        raise InvalidData(f"{path}: states an image of {shape}, beyond {MAX_BYTES >> 30} GiB")
    counts: npt.NDArray[Any] = np.zeros(shape, np.float64 if images[0].counts.dtype.kind == "f" else np.uint32)
    histograms: list[npt.NDArray[np.float64]] = []
    for image in images:
        for channel in image.counts.reshape(-1, *shape):
            if wanted in (None, len(histograms)):
                counts += channel.astype(counts.dtype)
            histograms.append(channel.sum(axis=(0, 1), dtype=np.float64))
    names, width_s = range(len(histograms)), images[0].bin_width_s
    if wanted is not None:
        said: str | None = one_alone({name: int(histograms[name].sum()) for name in names}, wanted, str(path))
    else:
        said = added_up(np.stack(histograms), names, width_s, "{} images (detectors, or pages)")
    notes = [] if said is None else [said]
    measured_s = max(image.measured_s for image in images)
    if not measured_s > 0:
        return counts, np.ones((rows, cols)), [*notes, "exposure is not stored; assuming 1 s per point"]
    notes.append(f"exposure per point is not stored; assuming the {measured_s:g} s of the measurement spread evenly")
    return counts, np.full((rows, cols), measured_s / (rows * cols)), notes


def _row(path: Path, blocks: list[_Block]) -> tuple[npt.NDArray[Any], npt.NDArray[np.float64], list[str]]:
    """Every curve as a point: counts (1, N, T), exposures (1, N), and what was assumed."""
    curves = [block.counts.reshape(-1, block.counts.shape[-1]) for block in blocks]
    lengths = {each.shape[1] for each in curves}
    if len(lengths) > 1:
        raise InvalidData(f"{path}: its curves have {', '.join(map(str, sorted(lengths)))} bins. Save one kind a file.")
    counts = np.concatenate(curves)[None]
    if counts.nbytes > MAX_BYTES:
        raise InvalidData(f"{path}: states {counts.shape[1]} curves, beyond {MAX_BYTES >> 30} GiB")
    exposure_s = np.repeat([block.measured_s for block in blocks], [len(each) for each in curves])[None]
    if not exposure_s.all():
        return counts, np.ones(counts.shape[:2]), ["exposure is not stored; assuming 1 s per point"]
    return counts, exposure_s, []
