"""Photon-HDF5: single photons with their delays, as one histogram, as one a spot, or sorted into the points of a scan.

Format: Ingargiola et al., "Photon-HDF5: an open file format for timestamp-based single-molecule fluorescence
experiments" (Biophys. J. 110, 2016), version 0.5. It has marks but no word for what they divide; where `phconvert` made
a file of a PicoQuant scan, the instrument's own tags lie beside the photons (/user/picoquant) and say it.
"""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.detectors import added_up, one_alone
from nlos.acquisition.importers.given import NOTHING, Given, put_there
from nlos.acquisition.importers.imported import MOST_POINTS, ImportedScan
from nlos.acquisition.importers.marked_lines import marked_lines
from nlos.acquisition.importers.raw_histograms import raw_scan
from nlos.acquisition.importers.untrusted_hdf5 import (
    MAX_BYTES,
    find_dataset,
    needed_dataset,
    needed_number,
    open_hdf5,
    read_array,
)

_BINS = "nanotimes_specs/tcspc_unit"
_TAGS = "user/picoquant/tags"
_IMAGE = 3
"""What PicoQuant's Measurement_SubMode and ImgHdr_Dimensions say of an image."""
_MOST_BINS = 1 << 20
_MOST_SPOTS = 4096
_MOST_COMPARED = 1 << 24
"""Bins of the histograms of all detectors of a spot, one each."""
_FEWEST_SPECIAL = 16
"""So many records of one id do not all have delay 0 by chance."""
_MOST_NAMED = 8

Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class _Photons:
    """One `photon_data` group: a spot's photons, and the marks among them."""

    times: Integers  # (P,) in units of `clock_s`
    delays: Integers  # (P,) in bins
    mark_times: Integers  # (M,) rising
    mark_bits: Integers  # (M,) which inputs saw an edge
    bin_width_s: float
    clock_s: float
    notes: tuple[str, ...]
    """What was excluded, and what was added up."""


@dataclass(frozen=True)
class _Image:
    """How the instrument's tags divide photons into points; `start`, `stop`, `frame` are bits of marks."""

    rows: int
    cols: int
    start: int
    stop: int
    frame: int
    two_ways: bool


def is_photon_hdf5(file: h5py.File) -> bool:
    """Whether an HDF5 file says that it is Photon-HDF5, or is laid out like it."""
    said = file.attrs.get("format_name")
    if isinstance(said, bytes | str) and said in (b"Photon-HDF5", "Photon-HDF5"):
        return True
    return bool({"photon_data", "photon_data0"} & set(file.keys()))


def read_photon_hdf5(path: Path, given: Given = NOTHING) -> ImportedScan:
    """Reads photons as a scan: an image where marks divide them, else a point for each spot. Raises `InvalidData`."""
    with open_hdf5(path) as file:
        groups = _groups(file)
        spots = [_photons(file, group, given) for group in groups.values()]
        image = _image(file, marks=sum(len(spot.mark_times) for spot in spots))
        units = [find_dataset(file, f"{group}/{_BINS}") for group in groups.values()]
        stored = None if units[0] is None or units[0].size != 1 else units[0][()]
        duration = find_dataset(file, "acquisition_duration")
        duration_s = 0.0 if duration is None else needed_number(file, "acquisition_duration")
    if len({spot.bin_width_s for spot in spots}) > 1:
        raise InvalidData(f"{path}: its spots have bins of different widths. Save one spot a file.")
    notes = _of_spots(dict(zip(groups, spots, strict=True))) + given.other_bins(stored)
    if image is not None and len(spots) == 1:
        counts, exposure_s = _sorted(path, spots[0], image)
        notes.append("photons between lines are not points of the scan and are not imported")
    else:
        spot_of = np.repeat(list(groups), [len(spot.delays) for spot in spots])
        delays = np.concatenate([spot.delays for spot in spots])
        counts = _histograms(path, spot_of, delays, (max(groups) + 1, int(delays.max()) + 1))[None]
        exposure_s = np.zeros(counts.shape[:2])
        exposure_s[0, list(groups)] = duration_s if duration_s > 0 else 1.0
        if missing := exposure_s.size - len(groups):
            notes.append(f"{missing} of {exposure_s.size} spots have no group of photons: not measured")
        notes.append("arrival times since the start and marks are not imported")
        if not duration_s > 0:
            notes.append("acquisition_duration is not stored; assuming 1 s per point")
    return raw_scan(counts, exposure_s, spots[0].bin_width_s, "Photon-HDF5", tuple(notes), str(path))


def _groups(file: h5py.File) -> dict[int, str]:
    """`photon_data`, or `photon_data0`, `photon_data1`, ... of several spots, some of which may have no photons."""
    if "photon_data" in file:
        return {0: "photon_data"}
    numbers = sorted(int(name[11:]) for name in file if name.startswith("photon_data") and name[11:].isdecimal())
    if not numbers:
        raise InvalidData(f"{file.filename}: is Photon-HDF5, but holds no photons (no group photon_data)")
    if numbers[-1] >= _MOST_SPOTS:
        raise InvalidData(f"{file.filename}: photon_data{numbers[-1]}: at most {_MOST_SPOTS} spots are read")
    return {number: f"photon_data{number}" for number in numbers}


def _photons(file: h5py.File, group: str, given: Given) -> _Photons:
    if find_dataset(file, f"{group}/nanotimes") is None:
        raise InvalidData(
            f"{file.filename}: {group}/nanotimes: is missing: photons without their delay after the laser pulse make "
            "no histograms. Convert a measurement that was timed against the laser (TCSPC, T3)."
        )
    if given.bin_width_s is None and find_dataset(file, f"{group}/{_BINS}") is None:
        raise InvalidData(f"{file.filename}: {group}/{_BINS}: is missing. {put_there('--bin-width-ps PS')}")
    width_s = given.bin_width_s or needed_number(file, f"{group}/{_BINS}")
    times, delays = _integers(file, f"{group}/timestamps"), _integers(file, f"{group}/nanotimes")
    stored = find_dataset(file, f"{group}/detectors")
    detectors = np.zeros_like(times) if stored is None else _integers(file, f"{group}/detectors")
    if not len(times) == len(delays) == len(detectors):
        raise InvalidData(
            f"{file.filename}: {group}: has {len(times)} timestamps, {len(delays)} nanotimes and {len(detectors)} "
            "detectors; one of each photon is expected"
        )
    marks = np.isin(detectors, _mark_ids(file, group))
    clock_s = needed_number(file, f"{group}/timestamps_specs/timestamps_unit")
    mark_times, mark_ids = times[marks], detectors[marks]
    times, delays, detectors = times[~marks], delays[~marks], detectors[~marks]
    stated = find_dataset(file, f"{group}/nanotimes_specs/tcspc_num_bins")
    bins = _MOST_BINS if stated is None else needed_number(file, f"{group}/nanotimes_specs/tcspc_num_bins")
    if not delays.size:
        raise InvalidData(f"{file.filename}: {group}: holds no photons")
    if delays.min() < 0 or delays.max() >= min(bins, _MOST_BINS):
        raise InvalidData(
            f"{file.filename}: {group}/nanotimes: from {delays.min()} to {delays.max()}, beyond its {bins:g} bins"
        )
    order = np.argsort(mark_times, kind="stable")
    times, delays, detectors, notes = _without_special(times, delays, detectors)
    if given.detector is not None:
        kinds, sizes = np.unique(detectors, return_counts=True)
        photons = dict(zip(kinds.tolist(), sizes.tolist(), strict=True))
        notes.append(one_alone(photons, given.detector, f"{file.filename}: {group}"))
        times, delays = times[detectors == given.detector], delays[detectors == given.detector]
    elif (said := _added_up(delays, detectors, width_s)) is not None:
        notes.append(said)
    return _Photons(times, delays, mark_times[order], _without_top_bit(mark_ids[order]), width_s, clock_s, tuple(notes))


def _without_special(
    times: Integers, delays: Integers, detectors: Integers
) -> tuple[Integers, Integers, Integers, list[str]]:
    """Photons without an instrument's special records, and what is to be said of those: of a PT3, `phconvert` leaves
    PicoHarp's overflows among the photons, as a detector 15 whose delays are all 0."""
    kinds, sizes = np.unique(detectors, return_counts=True)
    timed = np.isin(kinds, detectors[delays > 0])
    special = ~timed & timed.any()
    if not (special & (sizes >= _FEWEST_SPECIAL)).any():  # one photon's delay may well be 0
        return times, delays, detectors, []
    kept = ~np.isin(detectors, kinds[special])
    named = [f"{size:,} of 'detector' {kind}" for kind, size in zip(kinds[special], sizes[special], strict=True)]
    note = (
        f"records that all have delay 0 are not imported, {', '.join(named[:_MOST_NAMED])}"
        f"{', ...' if len(named) > _MOST_NAMED else ''}: not photons but an instrument's special records (overflows, "
        "marks)"
    )
    return times[kept], delays[kept], detectors[kept], [note]


def _added_up(delays: Integers, detectors: Integers, bin_width_s: float) -> str | None:
    """What is to be said where photons are of several detectors."""
    kinds, bins = np.unique(detectors), int(delays.max()) + 1
    if len(kinds) * bins > _MOST_COMPARED:
        return f"photons of {len(kinds)} detectors are added up" if len(kinds) > 1 else None
    cell = np.searchsorted(kinds, detectors) * bins + delays
    histograms = np.bincount(cell, minlength=len(kinds) * bins).reshape(len(kinds), bins)
    return added_up(histograms, kinds.tolist(), bin_width_s)


def _of_spots(spots: dict[int, _Photons]) -> list[str]:
    """What is to be said of all spots, with their numbers where there are several."""
    notes = [
        note if len(spots) == 1 else f"spot {number}: {note}" for number, spot in spots.items() for note in spot.notes
    ]
    if len(notes) > _MOST_NAMED:
        notes[_MOST_NAMED:] = [f"and {len(notes) - _MOST_NAMED} more notes of this kind, on other spots"]
    return notes


def _mark_ids(file: h5py.File, group: str) -> Integers:
    """The "detectors" that are inputs for marks."""
    found: list[Integers] = []
    while find_dataset(file, name := f"{group}/measurement_specs/detectors_specs/non_photon_id{len(found) + 1}"):
        found.append(_integers(file, name))
    return np.concatenate(found) if found else np.zeros(0, np.int64)


def _without_top_bit(ids: Integers) -> Integers:
    """A mark's bits: `phconvert` puts them below a bit that no detector has."""
    return ids - (1 << np.log2(np.maximum(ids, 1)).astype(np.int64))


def _integers(file: h5py.File, name: str) -> Integers:
    dataset = needed_dataset(file, name)
    if dataset.dtype.kind not in "ui":
        raise InvalidData(f"{file.filename}: {name}: holds {dataset.dtype}; whole numbers are expected")
    return read_array(dataset, 1).astype(np.int64)


def _image(file: h5py.File, marks: int) -> _Image | None:
    """How the photons are divided into points; None where they are of one point. Raises `InvalidData` where marks
    divide them and nothing says how."""

    def tag(name: str) -> int | None:
        place = f"{_TAGS}/{name}/value"
        value = None if find_dataset(file, place) is None else needed_number(file, place)
        return int(value) if value is not None and abs(value) < 1 << 31 else None

    if (mode := tag("Measurement_SubMode")) != _IMAGE:
        if mode is None and marks:
            raise InvalidData(
                f"{file.filename}: holds {marks} marks, and nothing says how they divide a scan into points (the tags "
                f"ImgHdr_PixX, ... in /{_TAGS}). Import the instrument's own file instead (PTU, SDT)."
            )
        return None
    rows, cols = tag("ImgHdr_PixY") or 0, tag("ImgHdr_PixX") or 0
    if tag("ImgHdr_Dimensions") not in (None, _IMAGE) or tag("ImgHdr_SinCorrection"):
        raise InvalidData(
            f"{file.filename}: is a line scan, or one of a resonant mirror; images of even lines are read"
        )
    if not (rows > 0 and cols > 0 and rows * cols <= MOST_POINTS):
        raise InvalidData(f"{file.filename}: {_TAGS}: state an image of {rows} x {cols} points")
    inputs = [tag(f"ImgHdr_{name}") or 0 for name in ("LineStart", "LineStop", "Frame")]
    if not all(0 <= number <= 8 for number in inputs):
        raise InvalidData(f"{file.filename}: {_TAGS}: state marks at inputs {inputs}")
    start, stop, frame = (1 << (number - 1) if number else 0 for number in inputs)
    return _Image(rows, cols, start, stop, frame, bool(tag("ImgHdr_BiDirect")))


def _sorted(path: Path, photons: _Photons, image: _Image) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.float64]]:
    """Counts (H, W, T) and exposures (H, W) of an image. Raises `InvalidData` where its lines are not as stated."""
    starts, stops, frames = (
        photons.mark_times[photons.mark_bits & bit > 0] for bit in (image.start, image.stop, image.frame)
    )
    lines = marked_lines(starts, stops, frames)
    if not photons.mark_times.size:
        raise InvalidData(
            f"{path}: its tags state an image of {image.rows} lines, and nothing is said to be a mark: name the "
            "'detectors' that marks were stored as (phconvert: 64 and more) in detectors_specs, as non_photon_id1 = "
            "[65] and so on. Or import the instrument's own file."
        )
    if not lines.row.size or lines.row.max() >= image.rows:
        most = lines.row.max() + 1 if lines.row.size else 0
        raise InvalidData(f"{path}: has {most} marked lines in a frame; its tags state {image.rows}")
    point, within = lines.points(photons.times, image.cols, image.two_ways)
    delays = photons.delays[within]
    if not delays.size:
        raise InvalidData(f"{path}: holds no photons within its lines")
    counts = _histograms(path, point, delays, (image.rows * image.cols, int(delays.max()) + 1))
    exposure_s = lines.dwell(image.rows, image.cols) * photons.clock_s
    return counts.reshape(image.rows, image.cols, -1), exposure_s


def _histograms(
    path: Path, point: npt.NDArray[np.integer], delays: Integers, shape: tuple[int, int]
) -> npt.NDArray[np.uint32]:
    """Histograms (points, T) of that shape, of photons that belong to `point` each."""
    points, bins = shape
    if points * bins * 4 > MAX_BYTES:
        raise InvalidData(f"{path}: states {points} points of {bins} bins, beyond {MAX_BYTES >> 30} GiB")
    counts = np.zeros(shape, np.uint32)
    np.add.at(counts, (point, delays), 1)
    return counts
