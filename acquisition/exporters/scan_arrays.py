"""A scan as plain arrays, on its grid or at free positions: what every exporter writes in its own words."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import FreePoints, ImportedScan
from nlos.acquisition.importers.to_recording import said_by_source
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid


@dataclass(frozen=True)
class Scanner:
    """Where laser and detector stand, and how much later than its way takes light is recorded."""

    position_m: tuple[float, float, float]
    """Wall coordinates; z is the distance from the wall."""
    delay_s: float


@dataclass(frozen=True)
class ScanArrays:
    """Counts [H, W, T] with positions of columns and rows, or [N, T] with one position each."""

    histograms: npt.NDArray[np.uint32]  # (H, W, T) or (N, T)
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

    @property
    def on_grid(self) -> bool:
        return self.histograms.ndim == 3


def arrays_of_recording(recording: Recording) -> ScanArrays:
    """All intact samples, visits of one position added up."""
    plan, rectified = recording.plan, bool(said_by_source(recording).get("rectified", False))
    time = TimeAxis(plan.axis.bins, plan.axis.bin_width_s, plan.axis.offset_s)
    if recording.on_grid:
        transient = recording.transient()
        counts = np.ascontiguousarray(np.moveaxis(transient.counts, 0, 2)).astype(np.uint32)
        x_m, y_m = plan.wall.x_m(), plan.wall.y_m()
        held = ScanArrays(counts, transient.exposure_s, x_m, y_m, plan.wall, time, rectified)
        return replace(held, left_aside=recording.left_aside())
    places = np.stack([plan.positions.x_m, plan.positions.y_m], axis=1)
    unique, place_of = np.unique(places, axis=0, return_inverse=True)
    counts = np.zeros((len(unique), plan.axis.bins), dtype=np.uint32)
    exposure_s = np.zeros(len(unique))
    for sample in recording.samples():
        place = place_of.ravel()[sample.point.number]
        counts[place] += sample.histogram.counts
        exposure_s[place] += sample.histogram.live_time_s
    held = ScanArrays(counts, exposure_s, unique[:, 0], unique[:, 1], plan.wall, time, rectified)
    return replace(held, left_aside=recording.left_aside())


def arrays_of_import(scan: ImportedScan, path: Path) -> ScanArrays:
    """The arrays of another program's scan. Raises `InvalidData` where its counts are not whole numbers."""
    held = scan.held
    counts = held.counts if isinstance(held, FreePoints) else np.moveaxis(held.counts, 0, 2)
    whole = counts.astype(np.uint32)
    if not np.array_equal(whole, counts):
        raise InvalidData(f"{path}: its counts are not whole numbers; only photon counts are exported")
    places = (held.x_m, held.y_m) if isinstance(held, FreePoints) else (held.wall.x_m(), held.wall.y_m())
    return ScanArrays(np.ascontiguousarray(whole), held.exposure_s, *places, held.wall, held.time, scan.rectified)
