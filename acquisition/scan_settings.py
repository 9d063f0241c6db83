"""The scan file: wall, pattern, dwell and histogram, and the plan that they make."""

from pydantic import Field

from acquisition.exposure import Exposure, Uniform
from acquisition.patterns import Pattern
from acquisition.plan import ScanPlan
from acquisition.wall import WallGrid
from configs.settings import Settings
from drivers.tcspc.counter import HistogramAxis

MAX_POINTS = 4096 * 4096


class WallSettings(Settings):
    """The scanned part of the relay wall, and the grid on it."""

    width_m: float = Field(gt=0, le=100)
    height_m: float = Field(gt=0, le=100)
    rows: int = Field(ge=1, le=4096)
    cols: int = Field(ge=1, le=4096)


class HistogramSettings(Settings):
    """The time axis that the counter is set to: `bins` of `bin_width_ps`, from `offset_ns` after the sync pulse."""

    bins: int = Field(ge=64, le=65536)
    bin_width_ps: float = Field(gt=0, le=1e6)
    offset_ns: float = Field(default=0.0, ge=0, le=1e8)


class ScanSettings(Settings):
    """A scan file. `dwell_ms` is each point's time before the exposure policy distributes it."""

    wall: WallSettings
    pattern: Pattern
    dwell_ms: float = Field(ge=0.001, le=10_000)
    histogram: HistogramSettings
    exposure: Exposure = Uniform()

    def plan(self) -> ScanPlan:
        """The plan: positions in order, and a dwell for each visit."""
        wall = WallGrid(self.wall.width_m, self.wall.height_m, self.wall.rows, self.wall.cols)
        positions = self.pattern.points(wall)
        visits = self.exposure.visits(positions, self.dwell_ms * 1e-3)
        axis = HistogramAxis(self.histogram.bins, self.histogram.bin_width_ps * 1e-12, self.histogram.offset_ns * 1e-9)
        return ScanPlan(wall, axis, positions.take(visits.index), visits.dwell_s, visits.pass_)
