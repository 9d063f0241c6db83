"""PTU: a scan as a T3 image, one frame, one channel; the header is made by `ptufile` (C. Gohlke).

Its records are made here: `ptufile.imwrite` steps through every laser pulse, minutes where a scan takes hours.
Their layout is that of TTTRRecType 0x00010307 in the vendor's file format description.
"""

import io
import struct
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt
import ptufile

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.exporters.scan_arrays import ScanArrays
from nlos.acquisition.exporters.scan_facts import unsaid
from nlos.acquisition.importers.untrusted_hdf5 import MAX_BYTES

_MAX_BINS = 1 << 15  # 15 bits of delay in a generic T3 record
_PULSE_PERIOD_S = 100e-9
"""Where nobody counted pulses."""
_ALIKE = 1e-3
_WRAP = 1 << 10  # pulses that a record tells apart; how often they began anew is said by records of their own,
_MOST_WRAPS = _WRAP - 1  # each for as many times at once
_MOST_PULSES = 1 << 42  # 16 MiB of records for wraps alone
_OVERFLOW = 1 << 31 | 63 << 25
_LINE_START, _LINE_STOP, _FRAME = (1 << 31 | 1 << marker << 25 for marker in range(3))
_BLOCK = 1 << 20  # photons encoded at once

Integers = npt.NDArray[np.int64]
Records = npt.NDArray[np.uint32]


def write_ptu(scan: ScanArrays, path: Path) -> list[str]:
    """Writes every photon as a T3 record, its delay counted from time 0. Returns what the format cannot hold.

    Raises `InvalidData`, before anything is written, for free positions, for a scan of which no point was measured,
    for more bins than a record can tell apart, of a rectified scan from time 0 on, and for more photons than are read
    back.
    """
    if not scan.on_grid:
        raise InvalidData(f"{path}: a PTU image needs a grid; export free positions to npz")
    rows, cols, bins = scan.histograms.shape
    if bins > _MAX_BINS:
        raise InvalidData(f"{path}: {bins} bins; a T3 record tells {_MAX_BINS} apart. Rebin, or export npz.")
    late, of_time = _first_delay(scan, path)
    measured_s = scan.exposure_s[scan.exposure_s > 0]
    if not measured_s.size:
        raise InvalidData(f"{path}: no point of the scan was measured; there is nothing to export")
    stated_s = float(measured_s.mean())
    laser_s = scan.laser_period_s
    least_s = max((late + bins + 1) * scan.time.bin_width_s, rows * cols * stated_s / _MOST_PULSES)
    period_s = max(laser_s or _PULSE_PERIOD_S, least_s)
    dwell = max(1, int(stated_s / period_s * (1 + 1e-9)))
    dwell_s = max(stated_s, period_s)
    period_s = dwell_s / dwell  # readers count a dwell in whole periods
    of_point = scan.histograms.sum(axis=2, dtype=np.int64)
    photons, pulses = int(of_point.sum()), rows * cols * dwell
    most_records = photons + min(photons + 2 * rows, pulses // _WRAP) + pulses // (_WRAP * _MOST_WRAPS) + 2 * rows + 2
    if 4 * most_records > MAX_BYTES:
        raise InvalidData(
            f"{path}: {photons:,} photons; a PTU has a record of each, {4 * most_records / 2**30:.1f} GiB, and at most "
            f"{MAX_BYTES >> 30} GiB are read back. Export npz."
        )
    head = _header((1, rows, cols, 1, late + bins), period_s, dwell_s, scan)
    with path.open("wb") as file:
        file.write(head)
        written = sum(file.write(records) for records in _records(scan.histograms, dwell, late))
        file.seek(0)
        file.write(_stating(_stating(head, "TTResult_NumberOfRecords", written // 4), "ImgHdr_MaxFrames", 1))
    notes = [*_of_the_scan(scan), *of_time, *_of_exposures(scan.exposure_s, measured_s, dwell_s)]
    if laser_s is None or abs(period_s / laser_s - 1) > _ALIKE:
        is_ = "is not known" if laser_s is None else f"is {laser_s * 1e9:.5g} ns"
        notes.append(f"the laser's period {is_}: pulses are written {period_s * 1e9:g} ns apart")
    if dark := bins - 1 - int(np.flatnonzero(scan.histograms.any(axis=(0, 1))).max(initial=-1)):
        notes.append(f"the last {dark} bins hold no photon: a PTU ends with its latest one")
    if bright := int((of_point > dwell).sum()):
        notes.append(f"{bright} of {rows * cols} points have more photons than laser pulses: several share one")
    return notes


def _of_the_scan(scan: ScanArrays) -> list[str]:
    notes = [
        f"the wall's size has no place in PTU: read it with --wall-size-m {scan.wall.width_m:g}x{scan.wall.height_m:g}",
        "photons are spread evenly over each dwell: arrival order is not stored",
    ]
    if scan.rectified:
        notes.append("that time 0 is the wall has no place in PTU: read it with --rectified")
    return [*notes, *unsaid(scan)]


def _first_delay(scan: ScanArrays, path: Path) -> tuple[int, list[str]]:
    """The delay of the first bin, in bins, and what to say of it. Raises `InvalidData` for a rectified scan that is too
    late for it: of others, light tells when it was at the wall, so that theirs may count from anywhere."""
    at, bins = scan.time.start_s / scan.time.bin_width_s, scan.time.bins
    late = round(at)
    if late + bins > _MAX_BINS:
        begins = f"{scan.time.start_s * 1e9:g} ns after time 0"
        if scan.rectified:
            raise InvalidData(
                f"{path}: its {bins} bins begin {begins}, at bin {late}; a T3 record tells {_MAX_BINS} apart. Rebin, "
                "or export npz."
            )
        return 0, [f"delays count from the first bin, which is {begins}: a T3 record tells {_MAX_BINS} bins apart"]
    if abs(at - late) < 0.01:
        return late, []
    return late, [f"delays are whole bins: times are {abs(at - late) * scan.time.bin_width_s * 1e12:.2g} ps off"]


def _of_exposures(
    exposure_s: npt.NDArray[np.float64], measured_s: npt.NDArray[np.float64], dwell_s: float
) -> list[str]:
    """What is lost of exposures where an image has one for all of its points."""
    notes, least_s, most_s = [], float(measured_s.min()), float(measured_s.max())
    if most_s - least_s > 1e-6 * most_s:
        notes.append(f"exposures differ, {least_s:g} to {most_s:g} s: every point has their mean, {dwell_s:g} s")
    elif dwell_s > (1 + 1e-6) * most_s:
        notes.append(f"exposures of {most_s:g} s are below a laser period: {dwell_s:g} s is written")
    if unmeasured := exposure_s.size - measured_s.size:
        notes.append(f"{unmeasured} of {exposure_s.size} points were not measured: they read as measured and dark")
    return notes


def _header(shape: tuple[int, ...], period_s: float, dwell_s: float, scan: ScanArrays) -> bytes:
    stream = io.BytesIO()
    ptufile.PtuWriter(
        stream,
        shape,
        period_s,
        scan.time.bin_width_s,
        dwell_s,
        record_type=ptufile.PtuRecordType.GenericT3,
        tags={  # the first two are optional in the vendor's dictionary, but phconvert reads no file without them
            "HW_Type": "MultiHarp",  # whose records these are: the vendor's library takes names that it knows
            "MeasDesc_AcquisitionTime": max(1, round(float(scan.exposure_s.sum()) * 1e3)),  # ms
            "CreatorSW_Name": "nlos",
            "CreatorSW_Version": version("nlos"),
        },
    )
    return stream.getvalue()


def _stating(head: bytes, tag: str, value: int) -> bytes:
    """The header with another number for a tag: 32 bytes of name, index, type, and eight of value."""
    at = head.index(tag.encode()) + 40
    return head[:at] + struct.pack("<q", value) + head[at + 8 :]


def _records(counts: Records, dwell: int, begins: int) -> Iterator[bytes]:
    """The records of a frame of histograms (H, W, T) whose first bin has the delay `begins`, of `dwell` laser pulses a
    point, in pieces of bounded size."""
    wrapped = 0
    for pulses, words in _events(counts, dwell, begins):
        wraps = pulses // _WRAP
        missing = np.diff(wraps, prepend=wrapped)
        overflows = -(-missing // _MOST_WRAPS)
        place = np.arange(len(words)) + np.cumsum(overflows)
        records = np.full(int(place[-1]) + 1, _OVERFLOW | _MOST_WRAPS, "<u4")
        late = overflows > 0
        records[place[late] - 1] = _OVERFLOW | missing[late] - _MOST_WRAPS * (overflows[late] - 1)
        records[place] = words | pulses % _WRAP
        wrapped = int(wraps[-1])
        yield records.tobytes()


def _events(counts: Records, dwell: int, begins: int) -> Iterator[tuple[Integers, Integers]]:
    """Photons and markers in the order of time: their laser pulses, and their records but for those. Photons of a
    point are spread evenly over its dwell, by rising delay."""
    rows, cols, bins = counts.shape
    step = max(1, _BLOCK // (cols * bins))
    for first in range(0, rows, step):
        lines = counts[first : first + step]
        of_point = lines.sum(axis=2, dtype=np.int64).ravel()
        cells = np.pad(lines.reshape(len(lines), -1), ((0, 0), (1, 1)), constant_values=1)  # a line between its markers
        taken = np.flatnonzero(cells)
        ends = np.cumsum(cells.ravel()[taken], dtype=np.int64)
        before = np.cumsum(of_point) - of_point + 1 + 2 * (np.arange(of_point.size) // cols)  # events before a point's
        spacing = dwell / np.maximum(1, of_point)
        for begin in range(0, int(ends[-1]), _BLOCK):
            event = np.arange(begin, min(begin + _BLOCK, int(ends[-1])))
            row, at = np.divmod(taken[np.searchsorted(ends, event, side="right")], cells.shape[1])
            col, delay = np.divmod(at - 1, bins)
            starts, stops = col < 0, col == cols
            point = row * cols + np.clip(col, 0, cols - 1)
            within = np.minimum(((event - before[point] + 0.5) * spacing[point]).astype(np.int64), dwell - 1)
            within[starts] = 0
            within[stops] = dwell
            words = np.where(starts, _LINE_START, np.where(stops, _LINE_STOP, (begins + delay) * _WRAP))
            yield (first * cols + point) * dwell + within, words
    yield np.array([rows * cols * dwell]), np.array([_FRAME])
