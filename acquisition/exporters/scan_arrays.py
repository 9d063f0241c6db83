"""A scan as plain arrays, on its grid or at free positions: what every exporter writes in its own words."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import FreePoints, ImportedScan
from nlos.acquisition.importers.to_recording import said_by_source
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.response import Response, from_json
from nlos.acquisition.scanning.free_points import Counts, added
from nlos.acquisition.transient import EXACT, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid


@dataclass(frozen=True)
class Scanner:
    """Where laser and detector stand, and how much later than its way takes light is recorded."""

    position_m: tuple[float, float, float]
    """Wall coordinates; z is the distance from the wall."""
    error_m: tuple[float, float, float]
    """How well that is known, where the times that tell it are true to a bin."""
    delay_s: float


@dataclass(frozen=True)
class ScanArrays:
    """Counts [H, W, T] with positions of columns and rows, or [N, T] with one position each."""

    histograms: Counts  # (H, W, T) or (N, T); of 32 bits where no sum takes more
    exposure_s: npt.NDArray[np.float64]  # (H, W) or (N,)
    x_m: npt.NDArray[np.float64]  # (W,) or (N,)
    y_m: npt.NDArray[np.float64]  # (H,) or (N,)
    wall: WallGrid
    time: TimeAxis
    rectified: bool = False
    """Whether time 0 is already the arrival at the wall point."""
    scanner: Scanner | None = None
    """None where nobody has told."""
    left_aside: int = 0
    """Samples that were damaged or unreadable, and are not in it."""
    wall_known: bool = True
    """Whether anybody said how large the wall is; where not, 1 m was assumed."""
    direct_cut_bins: int = 0
    falloff: int | None = None
    time_offset_bins: npt.NDArray[np.float64] | None = None  # (H, W) or (N,)
    response: Response | None = None
    """These four as the file that the scan came from states them; see `ImportedScan`."""
    laser_period_s: float | None = None
    """By the sync pulses that were counted; None where none were."""

    @property
    def on_grid(self) -> bool:
        return self.histograms.ndim == 3


def arrays_of_recording(recording: Recording) -> ScanArrays:
    """All intact samples, visits of one position added up, free positions in the order of the plan, and what the file
    said that they were imported from."""
    plan = recording.plan
    time = TimeAxis(plan.axis.bins, plan.axis.bin_width_s, plan.axis.offset_s)
    if recording.on_grid:
        transient = recording.transient()
        counts = _whole_sums(recording, transient)
        held = ScanArrays(counts, transient.exposure_s, plan.wall.x_m(), plan.wall.y_m(), plan.wall, time)
        return _as_its_source(held, recording)
    places = np.stack([plan.positions.x_m, plan.positions.y_m], axis=1)
    unique, first, place_of = np.unique(places, axis=0, return_index=True, return_inverse=True)
    by_plan = np.argsort(first)
    unique, place_of = unique[by_plan], np.argsort(by_plan)[place_of.ravel()]
    counts = np.zeros((len(unique), plan.axis.bins), dtype=np.uint32)
    exposure_s = np.zeros(len(unique))
    for sample in recording.samples():
        place = place_of[sample.point.number]
        counts = added(counts, place, sample.histogram.counts)
        exposure_s[place] += sample.histogram.live_time_s
    return _as_its_source(ScanArrays(counts, exposure_s, unique[:, 0], unique[:, 1], plan.wall, time), recording)


def _whole_sums(recording: Recording, transient: Transient) -> Counts:
    """The counts of `transient` [H, W, T], added up anew where floats of 32 bits may have rounded them."""
    bins, rows, cols = transient.counts.shape
    if float(transient.counts.max(initial=0)) < EXACT:
        return np.moveaxis(transient.counts, 0, 2).astype(np.uint32, order="C")
    sums: Counts = np.zeros((rows * cols, bins), dtype=np.uint32)
    for sample in recording.samples():
        sums = added(sums, sample.point.row * cols + sample.point.col, sample.histogram.counts)
    return sums.reshape(rows, cols, bins)


def _as_its_source(held: ScanArrays, recording: Recording) -> ScanArrays:
    """With what the file said that a recording was imported from; one of `nlos scan` is raw."""
    said, rows = said_by_source(recording), recording.intact_records()
    pulses = int(rows["sync_count"].sum())
    cut, falloff, offsets = said.get("direct_cut_bins"), said.get("falloff"), said.get("time_offset_bins")
    return replace(
        held,
        rectified=bool(said.get("rectified", False)),
        left_aside=recording.left_aside(),
        wall_known=bool(said.get("wall_known", True)),
        direct_cut_bins=cut if isinstance(cut, int) else 0,
        falloff=falloff if isinstance(falloff, int) else None,
        time_offset_bins=np.asarray(offsets, dtype=np.float64) if isinstance(offsets, list) else None,
        response=from_json(said.get("response")),
        laser_period_s=float(rows["live_time_s"].sum()) / pulses if pulses else None,
    )


def arrays_of_import(scan: ImportedScan, path: Path) -> ScanArrays:
    """The arrays of another program's scan. Raises `InvalidData` where its counts are not whole numbers."""
    held = scan.held
    counts = held.counts if isinstance(held, FreePoints) else np.moveaxis(held.counts, 0, 2)
    whole = counts.astype(np.uint32 if counts.max(initial=0) <= np.iinfo(np.uint32).max else np.uint64)
    if not np.array_equal(whole, counts):
        raise InvalidData(f"{path}: its counts are not whole numbers; only photon counts are exported")
    places = (held.x_m, held.y_m) if isinstance(held, FreePoints) else (held.wall.x_m(), held.wall.y_m())
    return ScanArrays(
        np.ascontiguousarray(whole),
        held.exposure_s,
        *places,
        held.wall,
        held.time,
        scan.rectified,
        wall_known=scan.wall_known,
        direct_cut_bins=scan.direct_cut_bins,
        falloff=scan.falloff,
        time_offset_bins=scan.time_offset_bins,
        response=scan.response,
    )
