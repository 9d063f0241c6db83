"""PicoQuant files: PTU and PHU (`ptu.py`), and the older PT3, HT3, T3R, PHD, HHD and THD, told by their headers.

T2 files have no delay times and are refused by name.
"""

from pathlib import Path

import numpy as np

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.detectors import added_up, one_alone
from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.picoquant_headers import (
    Curve,
    RecordFile,
    hydraharp_curves,
    hydraharp_records,
    instrument_and_version,
    is_histograms,
    picoharp_curves,
    picoharp_records,
    timeharp_curves,
    timeharp_records,
)
from nlos.acquisition.importers.ptu import phu_curves, read_ptu
from nlos.acquisition.importers.raw_histograms import raw_scan
from nlos.acquisition.importers.untrusted_hdf5 import MAX_BYTES

SUFFIXES = (".ptu", ".phu", ".pt2", ".pt3", ".ht2", ".ht3", ".t3r", ".phd", ".hhd", ".thd")
MAGIC = (b"PQTTTR", b"PQHISTO", b"PicoHarp", b"HydraHar", b"TimeHarp")
KNOWN = "PTU, PHU, PT3, HT3, T3R, PHD, HHD, THD"


def read_picoquant(path: Path, given: Given = NOTHING) -> ImportedScan:
    """Reads a PicoQuant file as a scan. Raises `InvalidData` naming file and reason."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    if path.stat().st_size > MAX_BYTES:
        raise InvalidData(f"{path}: is {path.stat().st_size / 2**30:.1f} GiB; at most {MAX_BYTES >> 30} GiB are read")
    with path.open("rb") as file:
        magic = file.read(7)
    if magic[:6] == b"PQTTTR":
        return read_ptu(path, given)
    if magic == b"PQHISTO":
        return _points(path, "PicoQuant PHU", phu_curves(path), path.read_bytes())
    if not magic.startswith(tuple(known[:7] for known in MAGIC)):
        raise InvalidData(
            f"{path}: is no file of PicoQuant's ({KNOWN}), though its name says so: it begins with {magic!r}. "
            "A raw dump of records, as the vendor's demo programs write it, says nothing of its instrument: save PTU."
        )
    name, data = str(path), path.read_bytes()
    ident, version = instrument_and_version(name, data)
    match ident, version, is_histograms(name, data):
        case "PicoHarp 300", "2.0", True:
            return _points(path, "PicoHarp PHD", picoharp_curves(name, data), data)
        case "HydraHarp", "1.0" | "2.0", True:
            return _points(path, "HydraHarp HHD", hydraharp_curves(name, data), data)
        case "TimeHarp 200", "2.0" | "3.0" | "5.0" | "6.0", True:
            return _points(path, "TimeHarp THD", timeharp_curves(name, data), data)
        case "PicoHarp 300", "2.0", False:
            return _one_point(path, "PicoHarp PT3", picoharp_records(name, data), data, given.detector)
        case "HydraHarp", "1.0" | "2.0", False:
            return _one_point(path, "HydraHarp HT3", hydraharp_records(name, data), data, given.detector)
        case "TimeHarp 200", "5.0" | "6.0", False:
            return _one_point(path, "TimeHarp T3R", timeharp_records(name, data), data, given.detector)
    raise InvalidData(
        f"{path}: {ident!r} format {version!r} is not read; known: {KNOWN} (T3R 5.0 and 6.0). Save it with newer "
        "software of the vendor's."
    )


def _one_point(path: Path, name: str, head: RecordFile, data: bytes, wanted: int | None) -> ImportedScan:
    """All photons of a T3 file, or those of the detector that is `wanted`, as the histogram of one point."""
    if not head.t3:
        raise InvalidData(
            f"{path}: is a T2 measurement: it has no delay times, so no histograms. Measure in T3 mode, with the laser "
            "at the sync input."
        )
    there = (len(data) - head.records_at) // 4
    if not 0 <= head.records <= there:
        raise InvalidData(
            f"{path}: is cut off: its header states {head.records:,} records, {there:,} are there. Copy it again."
        )
    notes = []
    if head.records == 0 < there:
        notes.append(f"its header states no records, as of a measurement that was broken off: all {there:,} are read")
    records = np.frombuffer(data, "<u4", head.records or there, head.records_at)
    if head.instrument == "HydraHarp 400":
        photons = records[records >> 31 == 0]
        delays, detectors = (photons >> 10) & 0x7FFF, (photons >> 25) & 0x3F
    elif head.instrument == "PicoHarp 300":
        photons = records[records >> 28 != 15]
        delays, detectors = (photons >> 16) & 0xFFF, photons >> 28
    else:  # counts from the photon to the next laser pulse
        photons = records[(records >> 30) & 1 == 1]
        delays, detectors = 0xFFF - ((photons >> 16) & 0xFFF), (photons >> 28) & 3
    if delays.size == 0:
        raise InvalidData(f"{path}: holds no photons")
    histograms = np.zeros((int(detectors.max()) + 1, int(delays.max()) + 1), np.uint32)
    np.add.at(histograms, (detectors, delays), 1)
    notes.append("arrival times since the start and marker signals are not imported")
    if wanted is not None:
        notes.append(one_alone(dict(enumerate(histograms.sum(axis=1).tolist())), wanted, str(path)))
        histograms = histograms[wanted : wanted + 1]
    elif (said := added_up(histograms, range(len(histograms)), head.bin_width_s)) is not None:
        notes.append(said)
    if head.instrument == "TimeHarp 200":
        notes.append("delays are turned round: this instrument counts from the photon to the next laser pulse")
    exposure = np.full((1, 1), head.acquisition_s if head.acquisition_s > 0 else 1.0)
    counts = histograms.sum(axis=0, dtype=np.uint32)
    return raw_scan(counts[None, None], exposure, head.bin_width_s, name, tuple(notes), str(path))


def _points(path: Path, name: str, curves: list[Curve], data: bytes) -> ImportedScan:
    """Stored histograms as a row of points, all on the time axis of the coarsest."""
    if not curves:
        raise InvalidData(f"{path}: holds no histograms")
    coarsest_s = max(curve.bin_width_s for curve in curves)
    rows = []
    for index, curve in enumerate(curves):
        if not 0 < curve.bins <= 65536 or curve.at < 0:
            raise InvalidData(f"{path}: histogram {index}: states {curve.bins} bins at byte {curve.at}")
        if curve.at + 4 * curve.bins > len(data):
            raise InvalidData(
                f"{path}: is cut off: histogram {index} of {len(curves)} ends at byte {curve.at + 4 * curve.bins:,}, "
                f"the file at {len(data):,}. Copy it again."
            )
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
    if len(curves) > 1:
        notes.append(
            f"its {len(curves)} curves are read as points in a row, {sum(not curve.total for curve in curves)} of them "
            "empty. Curves of several detectors at one point are no scan: save one a file"
        )
    if len({curve.bin_width_s for curve in curves}) > 1:
        notes.append(f"finer histograms were summed to the coarsest bin width, {coarsest_s * 1e12:g} ps")
    return raw_scan(counts[None], exposure, coarsest_s, name, tuple(notes), str(path))
