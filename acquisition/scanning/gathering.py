"""Samples added up as they come: the raw transient so far, in whatever order they arrive."""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.exposure import unbiased_s
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.recording import MAX_CUBE_BYTES
from nlos.acquisition.sample import Sample
from nlos.acquisition.transient import TimeAxis, Transient


class Gathering:
    """Sums over the samples of a plan. Counts are whole numbers, so their order leaves no trace; of a point that came
    twice, only the first counts. `transient()` equals `Recording.transient()` of the same samples.

    Raises `InvalidData` for plans off the grid, and for more than 8 GiB of counts.
    """

    def __init__(self, plan: ScanPlan) -> None:
        wall, bins = plan.wall, plan.axis.bins
        if not plan.positions.on_grid:
            raise InvalidData("a plan of free positions has no picture while it runs; reconstruct it afterwards.")
        if wall.rows * wall.cols * bins * 4 > MAX_CUBE_BYTES:
            raise InvalidData(f"{wall.rows} x {wall.cols} x {bins} counts need more than 8 GiB")
        self.plan = plan
        self._counts = np.zeros((wall.rows, wall.cols, bins), dtype=np.float32)
        self._layers = int(plan.pass_.max()) + 1 if plan.frames == 1 else 1
        self._live_s = np.zeros((self._layers, wall.rows, wall.cols))
        self.sync_count = np.zeros((wall.rows, wall.cols))
        """Laser pulses while a point was exposed, (H, W)."""
        self.total_count = np.zeros((wall.rows, wall.cols))
        """Detections, those outside of the histogram too, (H, W)."""
        self._have = np.zeros(len(plan), dtype=np.bool_)

    def __len__(self) -> int:
        """How many points are in."""
        return int(np.count_nonzero(self._have))

    def add(self, sample: Sample) -> bool:
        """Adds one sample of the plan; False where that point was in already."""
        point, histogram = sample.point, sample.histogram
        if self._have[point.number]:
            return False
        self._have[point.number] = True
        self._counts[point.row, point.col] += histogram.counts
        self._live_s[point.pass_ % self._layers, point.row, point.col] += unbiased_s(histogram, self.plan.stop)
        self.sync_count[point.row, point.col] += histogram.sync_count
        self.total_count[point.row, point.col] += histogram.total_count
        return True

    def transient(self) -> Transient:
        """Raw counts so far; time starts at the sync pulse. A copy: adding more does not change it."""
        axis = self.plan.axis
        counts = np.ascontiguousarray(np.moveaxis(self._counts, 2, 0))
        time = TimeAxis(axis.bins, axis.bin_width_s, axis.offset_s)
        return Transient(counts, self._live_s.sum(axis=0), self.plan.wall, time)

    def rates_hz(self) -> npt.NDArray[np.float32]:
        """Detections per second of live time, (H, W); NaN where nothing was measured."""
        live_s = self._live_s.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            rates: npt.NDArray[np.float32] = np.where(live_s > 0, self.total_count / live_s, np.nan).astype(np.float32)
        return rates

    def place_of(self, numbers: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Where points of the plan lie, as indices into the grid read row by row."""
        positions = self.plan.positions
        return np.asarray(positions.row[numbers] * self.plan.wall.cols + positions.col[numbers], dtype=np.intp)

    def place_rates_hz(self) -> npt.NDArray[np.float32]:
        """`rates_hz`, row by row, (H * W,)."""
        return self.rates_hz().reshape(-1)

    def place_counts(self, place: int) -> npt.NDArray[np.float32]:
        """Counts of one point of the grid so far, (T,). Raises `IndexError` off the wall."""
        wall = self.plan.wall
        if not 0 <= place < wall.rows * wall.cols:
            raise IndexError(f"place {place} of {wall.rows} x {wall.cols}")
        return np.array(self._counts[divmod(place, wall.cols)])
