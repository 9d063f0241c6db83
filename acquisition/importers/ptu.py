"""PicoQuant's PTU (images of scan points, single points) and PHU (rows of stored histograms), decoded by `ptufile`
(C. Gohlke). T2 files have no delay times and are refused by name."""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import ptufile

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.detectors import added_up, one_alone
from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.picoquant_headers import Curve
from nlos.acquisition.importers.raw_histograms import raw_scan
from nlos.acquisition.importers.untrusted_hdf5 import MAX_BYTES

Histograms = npt.NDArray[np.uint32]
MOST_CURVES = 1 << 20
MOST_MARKER = 15
"""A T3 record has four bits for markers, each an input of its own or, of some instruments, a number."""
_MARKERS = ("ImgHdr_LineStart", "ImgHdr_LineStop", "ImgHdr_Frame")
_SIZES = ("ImgHdr_PixX", "ImgHdr_PixY")
_DAMAGE = (
    ptufile.PqFileError, ValueError, KeyError, IndexError, TypeError, OverflowError, ZeroDivisionError, struct.error,
    MemoryError, EOFError, AttributeError, UnicodeDecodeError, OSError, NameError,
)  # fmt: skip
"""What `ptufile` raises where a file is not as it should be."""


def read_ptu(path: Path, given: Given = NOTHING) -> ImportedScan:
    """An image, or a point. Raises `InvalidData` naming file and reason."""
    try:
        with ptufile.PtuFile(path) as ptu:
            if int(ptu.tags.get("Measurement_Mode", 3)) == 2:
                raise InvalidData(
                    f"{path}: is a T2 measurement: it has no delay times, so no histograms. Measure in T3 mode, with "
                    "the laser at the sync input."
                )
            notes = _whole(path, ptu)
            if int(ptu.tags.get("Measurement_SubMode", 0)) < 2:  # oscilloscope, point
                return _point(path, ptu, given.detector, notes)
            return _image(path, ptu, given.detector, notes)
    except _DAMAGE as error:
        if isinstance(error, InvalidData):
            raise
        raise InvalidData(f"{path}: not a readable PTU file ({type(error).__name__}: {error})") from error


def _whole(path: Path, ptu: ptufile.PtuFile) -> list[str]:
    """What is to be said of the number of records. Raises `InvalidData` where some that are stated are missing: they
    would come out as dark points."""
    stated = int(ptu.tags.get("TTResult_NumberOfRecords", 0))
    there = (path.stat().st_size - ptu.record_offset) // 4
    if stated > there:
        raise InvalidData(
            f"{path}: is cut off: its header states {stated:,} records, {there:,} are there. Copy it again."
        )
    if stated <= 0 < there:
        return [f"its header states no records, as of a measurement that was broken off: all {there:,} are read"]
    return []


def _image(path: Path, ptu: ptufile.PtuFile, wanted: int | None, notes: list[str]) -> ImportedScan:
    tags = ptu.tags
    for name in _MARKERS:  # `ptufile` makes 2^(marker - 1) of it
        if not 0 <= int(tags.get(name, 0)) <= MOST_MARKER:
            raise InvalidData(f"{path}: states marker {tags[name]} for {name}; there are 1 to {MOST_MARKER}")
    if int(tags.get("Measurement_SubMode", 0)) != 3:
        raise InvalidData(f"{path}: is a line measurement, not an image of scan points, nor one point")
    photons = int(ptu.number_photons)
    if not photons:
        raise InvalidData(f"{path}: holds no photons")
    if ptu.measurement_ndim == 3 and (missing := [name for name in _SIZES if name not in tags]):
        raise InvalidData(
            f"{path}: does not say of how many points its image is: its header lacks {' and '.join(missing)}. Store it "
            "again with the software that took it."
        )
    if not ptu.number_lines:
        said = ", ".join(f"{name[7:]} {tags.get(name, 'not stated')}" for name in _MARKERS)
        raise InvalidData(
            f"{path}: none of its {photons:,} photons lies within a line of the image: of its {ptu.number_markers:,} "
            f"markers none begins and ends one as its tags say ({said}; markers count from 1). Export the image as "
            "histograms from the software that took it, and import those."
        )
    shape = tuple(int(n) for n in ptu.shape)
    if len(shape) != 5:
        raise InvalidData(f"{path}: is no image of scan points: its axes are {''.join(ptu.dims)}")
    frames, rows, cols, _, bins = shape
    if min(shape) < 1 or rows * cols * bins * 4 > MAX_BYTES:
        raise InvalidData(f"{path}: states an image of {shape}, beyond {MAX_BYTES >> 30} GiB")
    detectors = _detectors(path, ptu, wanted, _histograms(ptu))
    photons = detectors.photons
    image = ptu.decode_image(frame=-1, channel=detectors.channel, dtype=np.uint32)
    counts = np.asarray(image).reshape(rows, cols, bins)
    placed = int(counts.sum(dtype=np.uint64))
    if not placed:
        raise InvalidData(f"{path}: none of its {photons:,} photons lies within a line of the image")
    if placed < photons:
        notes.append(
            f"{photons - placed:,} of {photons:,} photons, between lines and outside frames, are not points of the "
            "scan and are not imported"
        )
    notes += detectors.notes
    if frames > 1:
        notes.append(f"{frames} frames are added up")
    if not float(tags.get("ImgHdr_TimePerPixel", 0.0)) > 0:
        notes.append(f"the dwell is not stored; {ptu.pixel_time * 1e6:.4g} µs a point and frame by its line markers")
    exposure = np.full((rows, cols), float(ptu.pixel_time) * frames)
    sine = float(tags.get("ImgHdr_SinCorrection", 0)) / 100
    if sine:
        notes.append("the mirror moved as a sine: points at the sides were looked at for longer")
        exposure *= cols * np.diff(np.arcsin(np.linspace(-sine, sine, cols + 1))) / (2 * np.arcsin(sine))
    return raw_scan(counts, exposure, float(ptu.tcspc_resolution), "PTU image", tuple(notes), str(path))


def _point(path: Path, ptu: ptufile.PtuFile, wanted: int | None, notes: list[str]) -> ImportedScan:
    """All photons of a measurement of one point, whatever marks are among them. Raises `InvalidData` for none."""
    histograms = _histograms(ptu)
    if not histograms.any():
        raise InvalidData(f"{path}: holds no photons")
    detectors = _detectors(path, ptu, wanted, histograms)
    if wanted is not None:
        histograms = histograms[detectors.channel : detectors.channel + 1]
    counts = histograms.sum(axis=0, dtype=np.uint32)
    notes.append("is a measurement of one point: arrival times since the start and marker signals are not imported")
    notes += detectors.notes
    asked_ms, took_ms = (float(ptu.tags.get(name, 0.0)) for name in ("MeasDesc_AcquisitionTime", "TTResult_StopAfter"))
    lasted_s = 1e-3 * (took_ms if took_ms > 0 else asked_ms)
    exposure = np.full((1, 1), lasted_s if lasted_s > 0 else 1.0)
    return raw_scan(counts[None, None], exposure, float(ptu.tcspc_resolution), "PTU point", tuple(notes), str(path))


class _Detectors(NamedTuple):
    """Which of a file's are imported."""

    channel: int
    """Along `ptufile`'s axis of channels, which begins at the first that has photons; -1: all, added up."""
    photons: int
    notes: list[str]


def _histograms(ptu: ptufile.PtuFile) -> Histograms:
    """Of all of the file's photons, (channels, bins)."""
    return np.asarray(ptu.decode_histogram(dtype=np.uint32))


def _detectors(path: Path, ptu: ptufile.PtuFile, wanted: int | None, histograms: Histograms) -> _Detectors:
    """All, or the one that is `wanted`. Raises `InvalidData` where that has no photons."""
    first = int(ptu.active_channels[0]) if len(ptu.active_channels) else 0
    names = range(first, first + len(histograms))
    if wanted is None:
        said = added_up(histograms, names, float(ptu.tcspc_resolution))
        return _Detectors(-1, int(ptu.number_photons), [] if said is None else [said])
    photons = dict(zip(names, histograms.sum(axis=1, dtype=np.uint64).tolist(), strict=True))
    note = one_alone(photons, wanted, str(path))
    return _Detectors(wanted - first, photons[wanted], [note])


def phu_curves(path: Path) -> list[Curve]:
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
