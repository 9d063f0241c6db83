"""A raw scan as arrays: what every correction starts from."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.calibration.errors import InvalidData, SaturatedBins

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.unsignedinteger]
COUNTER_LIMITS = (65_535, 4_294_967_295)
"""A bin with this content has run into the end of a 16- or 32-bit counter."""

LOWEST_PLATEAU = 30
"""Below this many counts, bins of equal content lie side by side by chance."""


@dataclass(frozen=True, eq=False)
class RawPoints:
    """N histograms, where and how long they were taken. Laser pulses and clicks are 0 where the source has none. One is
    equal to itself alone, so that what was found of it can be kept."""

    counts: npt.NDArray[np.generic]  # (N, T)
    x_m: Floats  # (N,)
    y_m: Floats  # (N,)
    exposure_s: Floats  # (N,); live time, 0 = not measured
    sync_count: Floats  # (N,)
    total_count: Floats  # (N,); all clicks, those outside of the histogram too
    time: TimeAxis
    taken_s: Floats | None = None  # (N,); the middle of the exposure, since the scan's start; None where nobody says
    visits: "RawPoints | None" = None
    """The same photons visit by visit, where points were visited more than once."""
    scanner_m: Floats | None = None
    """(3,); where the bench's drawing has the scanner, in wall coordinates; None where nobody says."""

    def __post_init__(self) -> None:
        shapes = {a.shape for a in (self.x_m, self.y_m, self.exposure_s, self.sync_count, self.total_count)}
        if shapes != {self.counts.shape[:1]} or self.counts.shape[1:] != (self.time.bins,):
            raise InvalidData(f"counts {self.counts.shape}, {self.time.bins} bins and points {shapes} do not fit.")

    @property
    def period_s(self) -> float | None:
        """The laser's period, from live time and laser pulses."""
        pulses = float(self.sync_count.sum())
        return float(self.exposure_s[self.sync_count > 0].sum()) / pulses if pulses > 0 else None

    def select(self, rows: slice | npt.NDArray[np.bool_]) -> "RawPoints":
        """Some of the points."""
        return RawPoints(
            self.counts[rows],
            self.x_m[rows],
            self.y_m[rows],
            self.exposure_s[rows],
            self.sync_count[rows],
            self.total_count[rows],
            self.time,
            None if self.taken_s is None else self.taken_s[rows],
            scanner_m=self.scanner_m,
        )

    def scaled(self, factor: float) -> "RawPoints":
        """The same points on a wall that is `factor` times as large."""
        visits = None if self.visits is None else self.visits.scaled(factor)
        return replace(self, x_m=self.x_m * factor, y_m=self.y_m * factor, visits=visits)

    def check(self, cut_tops: bool = True) -> None:
        """Raises `InvalidData` or `SaturatedBins`, naming the first point whose histogram cannot be used and why.

        `cut_tops`: whether pulses that end in a plateau at the scan's maximum are refused; a published scan may have
        been cut for display, a raw one never is.
        """
        exposed = self.exposure_s
        if not np.isfinite(exposed).all() or (exposed < 0).any():
            point = int(np.argmax(~(exposed >= 0) | np.isinf(exposed)))
            raise InvalidData(f"{self.name(point)} has an exposure of {exposed[point]:g} s.")
        if not (exposed > 0).any():
            raise InvalidData(f"none of {len(exposed)} points was exposed.")
        counts = self.counts
        if counts.dtype.kind == "f":
            finite = np.isfinite(counts.sum(axis=1, dtype=np.float64))
            if not finite.all():
                self._refuse(~np.isfinite(counts), "counts must be finite numbers")
        if counts.dtype.kind != "u" and counts.min(initial=0) < 0:
            self._refuse(counts < 0, "raw counts are never negative")  # type: ignore[operator]
        limits = set(COUNTER_LIMITS)
        if counts.dtype.kind in "ui" and counts.dtype.itemsize < 8:
            limits.add(2 ** (8 * counts.dtype.itemsize - (counts.dtype.kind == "i")) - 1)
        if counts.dtype == np.float32:
            limits.add(int(np.float32(COUNTER_LIMITS[1])))  # which has no room for its last digits
        top = counts.max(initial=0)
        if float(top) in limits:
            point, bin_ = (int(i) for i in np.argwhere(counts == top)[0])
            raise SaturatedBins(
                f"{self.name(point)}, bin {bin_} holds {top:.0f} counts, the most that the counter can: it is "
                "saturated. Shorten the dwell or attenuate the light."
            )
        if cut_tops and top >= LOWEST_PLATEAU:
            self._check_tops(float(top))

    def _check_tops(self, top: float) -> None:
        """Three bins in a row at the very maximum of the scan are no coincidence: something cannot count further."""
        full = np.flatnonzero(self.counts == top)
        row = full // self.time.bins
        runs = np.flatnonzero((full[2:] - full[:-2] == 2) & (row[2:] == row[:-2])) if len(full) > 2 else full[:0]
        if len(runs):
            point, bin_ = divmod(int(full[runs[0]]), self.time.bins)
            raise SaturatedBins(
                f"{self.name(point)}, bins {bin_} to {bin_ + 2} all hold {top:g} counts, the most in the whole scan: "
                "whatever counted is saturated. Shorten the dwell or attenuate the light."
            )

    def name(self, point: int) -> str:
        """A point for people: its number and where it lies."""
        return f"point {point} at ({self.x_m[point]:+.3f} m, {self.y_m[point]:+.3f} m)"

    def _refuse(self, bad: npt.NDArray[np.bool_], reason: str) -> None:
        point, bin_ = (int(i) for i in np.argwhere(bad)[0])
        raise InvalidData(f"{self.name(point)}, bin {bin_} is {self.counts[point, bin_]}: {reason}.")


def from_transient(
    transient: Transient, sync_count: npt.ArrayLike = 0.0, total_count: npt.ArrayLike = 0.0
) -> RawPoints:
    """Points of a grid in row order; `sync_count` and `total_count` are (H, W) or one number."""
    wall = transient.wall
    x, y = np.meshgrid(wall.x_m(), wall.y_m())
    size = (wall.rows, wall.cols)
    return RawPoints(
        transient.counts.reshape(transient.time.bins, -1).T,
        x.ravel(),
        y.ravel(),
        np.asarray(transient.exposure_s, dtype=np.float64).ravel(),
        np.broadcast_to(np.asarray(sync_count, dtype=np.float64), size).ravel(),
        np.broadcast_to(np.asarray(total_count, dtype=np.float64), size).ravel(),
        transient.time,
    )


def from_samples(samples: Iterable[Sample], *, visits: bool = False) -> RawPoints:
    """Points in the order taken; histograms of one position taken in several passes are added up, and kept apart beside
    that with `visits`. Raises `SaturatedBins` for a sample that its counter flagged, `InvalidData` for none or for
    samples of different axes."""
    counts: Counts | None = None
    told: list[tuple[float, ...]] = []
    groups: dict[tuple[float, float], list[int]] = {}
    axes: set[tuple[int, float, float]] = set()
    for sample in samples:
        histogram, point = sample.histogram, sample.point
        if histogram.flags & type(histogram.flags).SATURATED:
            raise SaturatedBins(saturated(point))
        axes.add((len(histogram.counts), histogram.bin_width_s, histogram.offset_s))
        if len(axes) > 1:
            continue
        group = groups.setdefault((point.x_m, point.y_m), [len(groups)])
        group.append(len(told))
        if counts is None:
            counts = np.zeros((0, len(histogram.counts)), dtype=np.uint16)
        counts = _added(counts, len(told) if visits else group[0], histogram.counts)
        live_s = histogram.live_time_s
        middle_s = sample.taken_s + live_s / 2
        told.append((point.x_m, point.y_m, live_s, histogram.sync_count, histogram.total_count, middle_s))
    if counts is None:
        raise InvalidData("there is not one sample to calibrate from.")
    if len(axes) > 1:
        raise InvalidData(f"samples have {len(axes)} different time axes: {sorted(axes)[:3]}.")
    time, each = TimeAxis(*axes.pop()), np.array(told)
    together = [each[group[1:]] for group in groups.values()]
    counts.resize((len(each) if visits else len(together), time.bins), refcheck=False)
    if not visits or len(together) == len(each):
        return _grouped(counts, together, time)
    summed: Counts = np.zeros((len(together), time.bins), dtype=np.uint16)
    for place, *numbers in groups.values():
        for number in numbers:
            summed = _added(summed, place, counts[number])
    return replace(_grouped(summed, together, time), visits=_grouped(counts, [row[None] for row in each], time))


def _added(counts: Counts, row: int, histogram: npt.NDArray[np.unsignedinteger]) -> Counts:
    """`counts` (rows, T), or more rows of them, with a histogram (T,) added in one: held once, in as few bits as the
    largest takes, 16 at least."""
    if row >= len(counts):
        counts.resize((row + max(row // 8, 256), len(histogram)), refcheck=False)
    total = counts[row].astype(np.uint64) + histogram
    counts = counts.astype(np.promote_types(counts.dtype, np.min_scalar_type(total.max(initial=0))), copy=False)
    counts[row] = total
    return counts


def saturated(point: ScanPoint) -> str:
    """What to say of a point whose counter flagged a bin."""
    return (
        f"point {point.number} at ({point.x_m:+.3f} m, {point.y_m:+.3f} m): its counter says that a bin is saturated. "
        "Shorten the dwell or attenuate the light."
    )


def _grouped(counts: Counts, groups: Sequence[Floats], time: TimeAxis) -> RawPoints:
    """A point with its `counts` for each group of samples (K, 6) of one position: x, y, live time, pulses, clicks and
    the middle of the exposure."""
    x_m, y_m = np.array([group[0, :2] for group in groups]).T
    live_s, pulses, clicks = np.array([group[:, 2:5].sum(axis=0) for group in groups]).T
    taken_s = np.array([group[:, 5].mean() for group in groups])
    return RawPoints(counts, x_m.copy(), y_m.copy(), live_s.copy(), pulses.copy(), clicks.copy(), time, taken_s)


def from_sample(sample: Sample) -> RawPoints:
    """One sample as the only point."""
    histogram = sample.histogram
    return RawPoints(
        histogram.counts[None],
        np.array([sample.point.x_m]),
        np.array([sample.point.y_m]),
        np.array([histogram.live_time_s]),
        np.array([float(histogram.sync_count)]),
        np.array([float(histogram.total_count)]),
        TimeAxis(len(histogram.counts), histogram.bin_width_s, histogram.offset_s),
    )


def joined(runs: Sequence[RawPoints]) -> RawPoints:
    """All runs' points one after the other. Raises `InvalidData` where their time axes differ."""
    first = runs[0]
    for run in runs[1:]:
        if run.time != first.time:
            raise InvalidData(
                f"runs of different time axes cannot be calibrated together: {first.time.bins} bins of "
                f"{first.time.bin_width_s * 1e12:g} ps from {first.time.start_s * 1e9:g} ns, and {run.time.bins} of "
                f"{run.time.bin_width_s * 1e12:g} ps from {run.time.start_s * 1e9:g} ns."
            )
    if len(runs) == 1:
        return first
    return RawPoints(
        np.concatenate([run.counts for run in runs]),
        np.concatenate([run.x_m for run in runs]),
        np.concatenate([run.y_m for run in runs]),
        np.concatenate([run.exposure_s for run in runs]),
        np.concatenate([run.sync_count for run in runs]),
        np.concatenate([run.total_count for run in runs]),
        first.time,
        scanner_m=first.scanner_m,
    )
