"""PicoQuant files: PTU images; points and rows of points in PTU, PHU, and the older PT3, HT3, T3R, PHD and HHD.

PTU's records and PHU's tags are decoded by `ptufile` (C. Gohlke). T2 files have no delay times and are refused by name.
"""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import ptufile

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.picoquant_headers import (
    Curve,
    RecordFile,
    hydraharp_curves,
    hydraharp_records,
    instrument_and_version,
    picoharp_curves,
    picoharp_records,
    timeharp_records,
)
from nlos.acquisition.importers.raw_histograms import raw_scan
from nlos.acquisition.importers.untrusted_hdf5 import MAX_BYTES

SUFFIXES = (".ptu", ".phu", ".pt2", ".pt3", ".ht2", ".ht3", ".t3r", ".phd", ".hhd")

MOST_CURVES = 1 << 20
MOST_MARKER = 15
"""A T3 record has four bits for markers, each an input of its own or, of some instruments, a number."""
_MARKERS = ("ImgHdr_LineStart", "ImgHdr_LineStop", "ImgHdr_Frame")
_DAMAGE = (
    ptufile.PqFileError, ValueError, KeyError, IndexError, TypeError, OverflowError, ZeroDivisionError, struct.error,
    MemoryError, EOFError, AttributeError, UnicodeDecodeError, OSError, NameError,
)  # fmt: skip
"""What `ptufile` raises where a file is not as it should be."""


def read_picoquant(path: Path) -> ImportedScan:
    """Reads a PicoQuant file as a scan. Raises `InvalidData` naming file and reason."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    if path.stat().st_size > MAX_BYTES:
        raise InvalidData(f"{path}: is {path.stat().st_size / 2**30:.1f} GiB; at most {MAX_BYTES >> 30} GiB are read")
    with path.open("rb") as file:
        magic = file.read(7)
    if magic[:6] == b"PQTTTR":
        return _read_ptu(path)
    if magic == b"PQHISTO":
        return _points(path, "PicoQuant PHU", _phu_curves(path), path.read_bytes())
    name, data = str(path), path.read_bytes()
    ident, version = instrument_and_version(name, data)
    suffix = path.suffix.lower()
    match ident, version, suffix:
        case "PicoHarp 300", "2.0", ".phd":
            return _points(path, "PicoHarp PHD", picoharp_curves(name, data), data)
        case "HydraHarp", "1.0" | "2.0", ".hhd":
            return _points(path, "HydraHarp HHD", hydraharp_curves(name, data), data)
        case "PicoHarp 300", "2.0", _:
            return _one_point(path, "PicoHarp PT3", picoharp_records(name, data), data)
        case "HydraHarp", "1.0" | "2.0", _:
            return _one_point(path, "HydraHarp HT3", hydraharp_records(name, data), data)
        case "TimeHarp 200", "5.0", _:
            return _one_point(path, "TimeHarp T3R", timeharp_records(name, data), data)
    raise InvalidData(f"{path}: {ident!r} format {version!r} is not read; known: PTU, PHU, PT3, HT3, T3R 5.0, PHD, HHD")


def _read_ptu(path: Path) -> ImportedScan:
    try:
        with ptufile.PtuFile(path) as ptu:
            tags = ptu.tags
            if int(tags.get("Measurement_Mode", 3)) == 2:
                raise InvalidData(f"{path}: is a T2 measurement: it has no delay times, so no histograms")
            if int(tags.get("Measurement_SubMode", 0)) < 2:  # oscilloscope, point
                return _ptu_point(path, ptu)
            for name in _MARKERS:  # `ptufile` makes 2^marker of it
                if not 0 <= int(tags.get(name, 0)) <= MOST_MARKER:
                    raise InvalidData(f"{path}: states marker {tags[name]} for {name}; there are 1 to {MOST_MARKER}")
            shape = tuple(int(n) for n in ptu.shape)
            if int(tags.get("Measurement_SubMode", 0)) != 3 or len(shape) != 5:
                raise InvalidData(f"{path}: is a line measurement, not an image of scan points, nor one point")
            _, rows, cols, _, bins = shape
            if min(shape) < 1 or rows * cols * bins * 4 > MAX_BYTES:
                raise InvalidData(f"{path}: states an image of {shape}, beyond {MAX_BYTES >> 30} GiB")
            image = np.asarray(ptu.decode_image(frame=-1, channel=-1, dtype=np.uint32))
            bin_width_s, dwell_s = float(ptu.tcspc_resolution), float(tags.get("ImgHdr_TimePerPixel", 0.0)) * 1e-3
            frames, sine = shape[0], float(tags.get("ImgHdr_SinCorrection", 0)) / 100
    except _DAMAGE as error:
        if isinstance(error, InvalidData):
            raise
        raise InvalidData(f"{path}: not a readable PTU file ({type(error).__name__}: {error})") from error
    counts = image.reshape(rows, cols, bins)
    notes = ["photons between lines and outside frames are not points of the scan and are not imported"]
    if not dwell_s > 0:
        notes.append("the dwell is not stored; assuming 1 s per point")
    exposure = np.full((rows, cols), dwell_s * frames if dwell_s > 0 else 1.0)
    if sine:
        notes.append("the mirror moved as a sine: points at the sides were looked at for longer")
        exposure *= cols * np.diff(np.arcsin(np.linspace(-sine, sine, cols + 1))) / (2 * np.arcsin(sine))
    return raw_scan(counts, exposure, bin_width_s, "PTU image", tuple(notes), str(path))


def _ptu_point(path: Path, ptu: ptufile.PtuFile) -> ImportedScan:
    """All photons of a measurement of one point, whatever marks are among them. Raises `InvalidData` for none."""
    curves = np.asarray(ptu.decode_histogram(dtype=np.uint32))
    counts = curves.sum(axis=0, dtype=np.uint32)
    if not counts.any():
        raise InvalidData(f"{path}: holds no photons")
    lasts_s = float(ptu.tags.get("MeasDesc_AcquisitionTime", 0.0)) * 1e-3
    notes = ["is a measurement of one point: arrival times since the start and marker signals are not imported"]
    if int(curves.any(axis=1).sum()) > 1:
        notes.append(f"photons of {int(curves.any(axis=1).sum())} channels are added up")
    exposure = np.full((1, 1), lasts_s if lasts_s > 0 else 1.0)
    return raw_scan(counts[None, None], exposure, float(ptu.tcspc_resolution), "PTU point", tuple(notes), str(path))


def _phu_curves(path: Path) -> list[Curve]:
    """Directory of the histograms in a .phu file. Raises `InvalidData` where its tags do not say them."""
    try:
        with ptufile.PhuFile(path) as phu:
            count, tags = int(phu.number_histograms), phu.tags
            if int(tags.get("HistoResult_BitsPerBin", 32)) != 32 or not 0 < count <= MOST_CURVES:
                raise InvalidData(f"{path}: states {count} histograms; 1 to {MOST_CURVES} of 32 bits a bin are read")
            found = [
                _each(tags, f"HistResDscr_{name}", count)
                for name in ("DataOffset", "HistogramBins", "MDescResolution", "IntegralCount", "MDescStopAfter")
            ]
    except _DAMAGE as error:
        if isinstance(error, InvalidData):
            raise
        raise InvalidData(f"{path}: not a readable PHU file ({type(error).__name__}: {error})") from error
    at, bins, width_s, total, stop_ms = found
    return [Curve(int(at[i]), int(bins[i]), width_s[i], stop_ms[i] * 1e-3, int(total[i])) for i in range(count)]


def _each(tags: Mapping[str, Any], name: str, count: int) -> list[float]:
    """A number of each histogram; of one alone `ptufile` may give the number itself."""
    values = np.asarray(tags[name], dtype=np.float64).ravel()
    if values.shape != (count,) or not np.isfinite(values).all():
        raise ValueError(f"{name} is not one number for each of {count} histograms")
    return [float(value) for value in values]


def _one_point(path: Path, name: str, head: RecordFile, data: bytes) -> ImportedScan:
    """All photons of a T3 file as the histogram of one point."""
    if not head.t3:
        raise InvalidData(f"{path}: is a T2 measurement: it has no delay times, so no histograms")
    if not 0 <= head.records <= (len(data) - head.records_at) // 4:
        raise InvalidData(f"{path}: states {head.records} records, but {len(data) - head.records_at} bytes follow")
    records = np.frombuffer(data, "<u4", head.records, head.records_at)
    if head.instrument == "HydraHarp 400":
        delays = (records[records >> 31 == 0] >> 10) & 0x7FFF
    elif head.instrument == "PicoHarp 300":
        delays = (records[records >> 28 != 15] >> 16) & 0xFFF
    else:
        delays = (records[(records >> 30) & 1 == 1] >> 16) & 0xFFF
    if delays.size == 0:
        raise InvalidData(f"{path}: holds no photons")
    counts = np.bincount(delays, minlength=1).astype(np.uint32)[None, None]
    notes = ["arrival times since the start and marker signals are not imported"]
    if head.instrument == "TimeHarp 200":
        notes.append("delays are as recorded: this instrument runs in reversed start-stop mode")
    exposure = np.full((1, 1), head.acquisition_s if head.acquisition_s > 0 else 1.0)
    return raw_scan(counts, exposure, head.bin_width_s, name, tuple(notes), str(path))


def _points(path: Path, name: str, curves: list[Curve], data: bytes) -> ImportedScan:
    """Stored histograms as a row of points, all on the time axis of the coarsest."""
    if not curves:
        raise InvalidData(f"{path}: holds no histograms")
    coarsest_s = max(curve.bin_width_s for curve in curves)
    rows = []
    for index, curve in enumerate(curves):
        if not 0 < curve.bins <= 65536 or curve.at < 0 or curve.at + 4 * curve.bins > len(data):
            raise InvalidData(f"{path}: histogram {index}: states {curve.bins} bins at byte {curve.at}")
        counts = np.frombuffer(data, "<u4", curve.bins, curve.at)
        if int(counts.sum(dtype=np.uint64)) != curve.total:
            raise InvalidData(f"{path}: histogram {index}: sums to {counts.sum()}, its header says {curve.total}")
        ratio = coarsest_s / curve.bin_width_s if curve.bin_width_s > 0 else 0.0
        if not 0.5 < ratio <= 65536 or abs(ratio - round(ratio)) > 1e-3:
            raise InvalidData(f"{path}: histogram {index}: {curve.bin_width_s:g} s bins do not fit {coarsest_s:g} s")
        starts = np.arange(0, curve.bins, round(ratio))
        rows.append(np.add.reduceat(counts, starts))
    bins = max(row.size for row in rows)
    counts = np.stack([np.pad(row, (0, bins - row.size)) for row in rows])
    exposure = np.array([[curve.acquisition_s if curve.acquisition_s > 0 else 1.0 for curve in curves]])
    notes = []
    if len({curve.bin_width_s for curve in curves}) > 1:
        notes.append(f"finer histograms were summed to the coarsest bin width, {coarsest_s * 1e12:g} ps")
    return raw_scan(counts[None], exposure, coarsest_s, name, tuple(notes), str(path))
