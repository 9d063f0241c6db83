"""A scan from any file, as arrays: our own recordings, every format that an importer knows, and what a user adds."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.imported import DOUBT, NO_WALL, ImportedScan
from nlos.acquisition.importers.isolated import read_isolated
from nlos.acquisition.importers.magic import is_recording
from nlos.acquisition.importers.to_recording import said_by_source
from nlos.acquisition.planning.exposure import unbiased_s
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.frames import rows_of
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.response import Response, from_json
from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.transient import Transient
from nlos.acquisition.wall import WallGrid
from nlos.calibration.errors import SaturatedBins
from nlos.calibration.raw_points import RawPoints, from_samples, from_transient, saturated
from nlos.calibration.wall_size import found_side
from nlos.drawn_bench import aimed_by, scanner_of
from nlos.file_doubts import doubt
from nlos.recon.gridding import grid_samples

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LoadedScan:
    """A scan from any file, before calibration."""

    transient: Transient
    devices: Mapping[str, str]
    """Role -> model and serial number; empty where the file does not say."""
    sync_count: npt.NDArray[np.float64]  # (H, W); 0 where not counted
    total_count: npt.NDArray[np.float64]  # (H, W)
    rectified: bool
    direct_cut_bins: int | None
    """The file's own cut; None where the direct light has to be found."""
    falloff: int | None
    offset_bins: npt.NDArray[np.float64] | None  # (H, W)
    """The file's own time offsets."""
    wall_known: bool = True
    """Whether the file says how large the wall is."""
    points: RawPoints | None = None
    """Samples at free positions as they were taken; `transient` then has them in the pixels they lie in."""
    bench_json: str = "{}"
    """The bench file that it was taken with, where it is known."""
    scanner_m: npt.NDArray[np.float64] | None = None
    """(3,); where that bench has the scanner, in wall coordinates; None where it does not say."""
    response: Response | None = None
    """What the instrument makes of an instant of light, as the file states it."""
    left_aside: int = 0
    """Samples that were damaged or unreadable, and are not in it."""
    full: tuple[ScanPoint, ...] = ()
    """Points of which the counter says that a bin could not count further."""
    rectified_assumed: bool = False
    """Whether nobody has said whether it is rectified."""
    no_direct_light: bool = False
    """Whether only `offset_bins` say when light reaches the wall: direct light is not in the record."""
    wall_error_m: float | None = None
    """The standard error of a width that the direct times told; None where they did not."""


def refuse_full(scan: LoadedScan) -> None:
    """Raises `SaturatedBins` where a bin could not count further, at whichever content that was."""
    if scan.full:
        raise SaturatedBins(saturated(scan.full[0]))


def load_scan(path: Path, given: Given = NOTHING, frames: range | None = None) -> LoadedScan:
    """Reads our own recordings, these `frames` of them or all added up, and every format that an importer knows; what
    is `given` goes before what the file says. A wall of unknown size is the one that the direct times tell. What was
    assumed is logged. Raises `InvalidData`."""
    if is_recording(path):
        with open_checked(path) as recording:
            scan = loaded_frames(recording, frames)
        scan = _as_given(path, scan, given)
    elif frames is not None:
        raise InvalidData(f"{path}: is no recording of `nlos scan`; it has no frames")
    else:
        read = read_isolated(path, given)
        for note in read.notes:
            if read.wall_known or not note.startswith(NO_WALL):
                log.log(logging.WARNING if note.startswith(DOUBT) else logging.INFO, "%s: %s", path, note)
        scan = _as_loaded(read)
        direct_light = not scan.rectified and scan.points is None
        doubt(str(path), scan.transient, wall_known=scan.wall_known, direct_light=direct_light)
    return scan if scan.wall_known else _on_found_wall(path, scan)


def _as_loaded(scan: ImportedScan) -> LoadedScan:
    """A file of another program."""
    cut, free = scan.direct_cut_bins if scan.direct_cut_bins > 0 else None, scan.points
    if free is None:
        transient, points = scan.transient, None
    else:
        nothing = np.zeros_like(free.exposure_s)
        points = RawPoints(free.counts, free.x_m, free.y_m, free.exposure_s, nothing, nothing, free.time)
        transient = _gridded(points, free.wall)
    nothing = np.zeros_like(transient.exposure_s)
    return LoadedScan(
        transient,
        {},
        nothing,
        nothing,
        scan.rectified,
        cut,
        scan.falloff,
        scan.time_offset_bins,
        scan.wall_known,
        points,
        response=scan.response,
        rectified_assumed=scan.rectified_assumed,
        no_direct_light=scan.no_direct_light,
    )


def _as_given(path: Path, scan: LoadedScan, given: Given) -> LoadedScan:
    """A recording with what a user says about it. Raises `InvalidData` for what only the recording can say."""
    if given.bin_width_s is not None or given.axes is not None or given.detector is not None:
        raise InvalidData(f"{path}: is a recording: it knows its bin width, the order of its axes and its detector")
    if given.wall_m is not None:
        if scan.points is not None:
            raise InvalidData(f"{path}: is a recording of free positions: it knows its wall")
        wall = replace(scan.transient.wall, width_m=given.wall_m[0], height_m=given.wall_m[1])
        scan = replace(scan, transient=replace(scan.transient, wall=wall), wall_known=True)
        log.info("%s: a wall of %g x %g m, as given", path, *given.wall_m)
    if given.rectified is not None:
        scan = said_rectified(scan, given.rectified)
        log.info("%s: %s, as given", path, "rectified" if given.rectified else "raw")
    return scan


def said_rectified(scan: LoadedScan, rectified: bool) -> LoadedScan:
    """The scan as a user says that it is, whatever its file says: of a raw one nothing was cut."""
    cut = scan.direct_cut_bins if rectified else None
    return replace(scan, rectified=rectified, direct_cut_bins=cut, rectified_assumed=False, no_direct_light=False)


def _on_found_wall(path: Path, scan: LoadedScan) -> LoadedScan:
    """A scan whose file does not say how large the wall is, on the wall that its direct times tell."""
    wall = scan.transient.wall
    found = None if scan.rectified else found_side(from_transient(scan.transient), wall.width_m)
    if found is None:
        log.warning(
            "%s: the wall's size is not stored, and the times do not tell it; assuming %g x %g m. "
            "Use --wall-size-m W or WxH.", path, wall.width_m, wall.height_m,
        )  # fmt: skip
        return scan
    log.info("%s: the wall's size is not stored: by the direct times it is %.3f +- %.3f m wide", path, *found)
    scale = found[0] / wall.width_m
    wall = replace(wall, width_m=wall.width_m * scale, height_m=wall.height_m * scale)
    return replace(scan, transient=replace(scan.transient, wall=wall), wall_error_m=found[1])


def _gridded(points: RawPoints, wall: WallGrid) -> Transient:
    return grid_samples(points.x_m, points.y_m, points.counts, points.exposure_s, wall, points.time)


def loaded_frames(recording: Recording, frames: range | None) -> LoadedScan:
    """Some frames of an open recording, added up, or all. Raises `InvalidData` for frames that it has not, or of which
    no point was taken."""
    scan = _load_recording(recording, frames) if recording.on_grid else _load_free(recording, frames)
    numbers = recording.records["number"][list(recording.condition().full)].tolist()
    full = tuple(recording.plan[number] for number in numbers)
    if frames is not None:
        full = tuple(point for point in full if point.pass_ in frames)
    return replace(scan, left_aside=recording.left_aside(), full=full)


def _rows(recording: Recording, frames: range | None) -> range:
    if frames is None:
        return range(len(recording))
    try:
        rows = rows_of(recording.plan, recording.records, frames)
    except InvalidData as error:
        raise InvalidData(f"{recording.path}: {error}") from None
    if not rows:
        what = f"frame {frames.start}" if len(frames) == 1 else f"frames {frames.start} to {frames.stop - 1}"
        raise InvalidData(f"{recording.path}: {what}: no point of it was taken. `nlos scan ... --resume` takes it.")
    return rows


def _load_recording(recording: Recording, frames: range | None) -> LoadedScan:
    """A recording on a grid."""
    _rows(recording, frames)  # refuses frames that it has not, or of which no point was taken
    transient = recording.transient(frames)
    sync_count, total_count = np.zeros_like(transient.exposure_s), np.zeros_like(transient.exposure_s)
    records = recording.intact_records()
    if frames is not None:
        frame = recording.plan.pass_[records["number"]]
        records = records[(frame >= frames.start) & (frame < frames.stop)]
    place = recording.plan.positions.row[records["number"]], recording.plan.positions.col[records["number"]]
    np.add.at(sync_count, place, records["sync_count"])
    np.add.at(total_count, place, records["total_count"])
    return as_recorded(recording, transient, sync_count, total_count)


def _unbiased(sample: Sample, plan: ScanPlan) -> Sample:
    """Of a plan that stops at counts, with the live time by which counts are divided."""
    live_s = unbiased_s(sample.histogram, plan.stop)
    return replace(sample, histogram=replace(sample.histogram, live_time_s=live_s))


def _load_free(recording: Recording, frames: range | None) -> LoadedScan:
    """A recording of points off the grid: what was drawn along a spiral, a circle, a line."""
    rows = _rows(recording, frames)
    samples = islice(recording.rows(rows.start), len(rows))
    points = from_samples(
        _unbiased(each, recording.plan)
        for each in samples
        if each is not None and (frames is None or each.point.pass_ in frames)
    )
    transient = _gridded(points, recording.plan.wall)
    nothing = np.zeros_like(transient.exposure_s)
    return replace(as_recorded(recording, transient, nothing, nothing), points=points)


def as_recorded(
    recording: Recording,
    transient: Transient,
    sync_count: npt.NDArray[np.float64],
    total_count: npt.NDArray[np.float64],
) -> LoadedScan:
    """All or some of a recording's samples; one that was imported keeps what its source said."""

    said = said_by_source(recording)
    cut, falloff, offsets = said.get("direct_cut_bins"), said.get("falloff"), said.get("time_offset_bins")
    return LoadedScan(
        transient,
        {role: f"{who.model} {who.serial}".strip() for role, who in recording.header.devices.items()},
        sync_count,
        total_count,
        bool(said.get("rectified", False)),
        cut if isinstance(cut, int) and cut > 0 else None,
        falloff if isinstance(falloff, int) else None,
        _offset_bins(recording, offsets, transient.exposure_s.shape) if isinstance(offsets, list) else None,
        bool(said.get("wall_known", True)),
        bench_json=recording.header.bench_json,
        scanner_m=_scanner(recording.header),
        response=_response(recording, said.get("response")),
        rectified_assumed=bool(said.get("rectified_assumed", False)),
        no_direct_light=isinstance(offsets, list) and bool(said.get("no_direct_light", False)),
    )


def _scanner(header: Header) -> npt.NDArray[np.float64] | None:
    """A geometry that cannot be read tells nothing: a picture can do without."""
    try:
        return scanner_of(aimed_by(header.constants_json, header.bench_json))
    except InvalidData:
        return None


def _response(recording: Recording, stored: object) -> Response | None:
    """The response that an imported file brought along. Raises `InvalidData` for anything else."""
    try:
        return from_json(stored)
    except InvalidData as error:
        raise InvalidData(f"{recording.path}: scan_json: {error}") from error


def _offset_bins(recording: Recording, stored: list[Any], shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """The offsets (H, W) that an imported file brought along. Raises `InvalidData` for anything else."""
    try:
        offsets = np.asarray(stored, dtype=np.float64)
    except (TypeError, ValueError):
        offsets = np.zeros(0)
    if offsets.shape != shape or not np.isfinite(offsets).all():
        raise InvalidData(
            f"{recording.path}: scan_json: time_offset_bins is not a {shape[0]} x {shape[1]} table of finite numbers. "
            "Import the original file again."
        )
    return offsets
