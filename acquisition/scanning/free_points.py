"""Samples at free positions added up as they come: what `Gathering` is for points of a grid."""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.exposure import unbiased_s
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.recording import MAX_CUBE_BYTES
from nlos.acquisition.sample import Sample
from nlos.acquisition.transient import TimeAxis

Counts = npt.NDArray[np.unsignedinteger]


class FreePoints:
    """Sums over the samples of a plan, place by place; of a point that was taken twice only the first counts.

    Raises `InvalidData` for more than 8 GiB of counts.
    """

    def __init__(self, plan: ScanPlan) -> None:
        places, self._place = np.unique(
            np.stack([plan.positions.x_m, plan.positions.y_m], axis=1), axis=0, return_inverse=True
        )
        self._place = self._place.reshape(-1)
        if len(places) * plan.axis.bins * 4 > MAX_CUBE_BYTES:
            raise InvalidData(f"{len(places)} places x {plan.axis.bins} counts need more than 8 GiB")
        self.plan = plan
        self.x_m, self.y_m = places[:, 0].copy(), places[:, 1].copy()
        """Of every place, (P,)."""
        self.counts: Counts = np.zeros((len(places), plan.axis.bins), dtype=np.uint32)  # (P, T), see `added`
        self.exposure_s, self.sync_count, self.total_count = np.zeros((3, len(places)))
        self._have = np.zeros(len(plan), dtype=np.bool_)

    def __len__(self) -> int:
        """How many points are in."""
        return int(np.count_nonzero(self._have))

    @property
    def time(self) -> TimeAxis:
        axis = self.plan.axis
        return TimeAxis(axis.bins, axis.bin_width_s, axis.offset_s)

    def place_of(self, numbers: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Where points of the plan lie, as indices of places."""
        return np.asarray(self._place[numbers], dtype=np.intp)

    def add(self, sample: Sample) -> bool:
        """Adds one sample of the plan; False where that point was in already."""
        number, histogram = sample.point.number, sample.histogram
        if self._have[number]:
            return False
        self._have[number] = True
        place = int(self._place[number])
        self.counts = added(self.counts, place, histogram.counts)
        self.exposure_s[place] += unbiased_s(histogram, self.plan.stop)
        self.sync_count[place] += histogram.sync_count
        self.total_count[place] += histogram.total_count
        return True

    def place_rates_hz(self) -> npt.NDArray[np.float32]:
        """Detections per second of live time, (P,); NaN where nothing was measured."""
        with np.errstate(divide="ignore", invalid="ignore"):
            rates = np.where(self.exposure_s > 0, self.total_count / self.exposure_s, np.nan)
        return np.asarray(rates, dtype=np.float32)

    def place_counts(self, place: int) -> npt.NDArray[np.float32]:
        """Counts at one place so far, (T,). Raises `IndexError` where there is no such place."""
        if not 0 <= place < len(self.counts):
            raise IndexError(f"place {place} of {len(self.counts)}")
        return np.array(self.counts[place], dtype=np.float32)


def added(sums: Counts, place: int, counts: Counts) -> Counts:
    """`sums` (P, T) with `counts` (T,) added at one place: in place, or as a copy of 64 bits from the first sum on that
    takes more than 32."""
    sums[place] += counts
    if sums.dtype.itemsize == 4 and (sums[place] < counts).any():  # it ran over
        sums[place] -= counts
        sums = sums.astype(np.uint64)
        sums[place] += counts
    return sums
