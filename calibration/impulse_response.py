"""The instrument's impulse response: what one instant of light looks like after laser pulse, detector and counter."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.response import full_width_steps

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
ROWS_AT_ONCE = 2048


@dataclass(frozen=True)
class ImpulseResponse:
    """Photon density over time, area 1, piecewise constant on steps of `step_s`; time 0 is its maximum.

    Step k covers [start_s + k step_s, start_s + (k + 1) step_s).
    """

    density: Floats  # (K,)
    step_s: float
    start_s: float

    def __post_init__(self) -> None:
        if self.density.ndim != 1 or not np.isfinite(self.density).all() or (self.density < 0).any():
            raise ValueError("an impulse response is a row of finite numbers that are not negative")
        if not (self.step_s > 0 and abs(self.density.sum() * self.step_s - 1) < 1e-6):
            raise ValueError("an impulse response has a step above 0 and an area of 1")

    @property
    def end_s(self) -> float:
        return self.start_s + len(self.density) * self.step_s

    def share_before(self, time_s: npt.ArrayLike) -> Floats:
        """Share of the photons that arrive before `time_s` after the maximum."""
        edges = self.start_s + np.arange(len(self.density) + 1) * self.step_s
        running = np.concatenate([[0.0], np.cumsum(self.density) * self.step_s])
        return np.asarray(np.interp(np.asarray(time_s, dtype=np.float64), edges, running))

    def in_bins(self, first_edge_s: npt.ArrayLike, bins: int, bin_width_s: float) -> Floats:
        """Share of photons in each of `bins` bins from `first_edge_s` on, shape (..., bins)."""
        edges = np.asarray(first_edge_s, dtype=np.float64)[..., None] + np.arange(bins + 1) * bin_width_s
        return np.diff(self.share_before(edges), axis=-1)

    def fwhm_s(self) -> float:
        """Full width at half maximum, between the outermost crossings, as reconstruction says it."""
        return full_width_steps(self.density) * self.step_s

    def cropped(self, level: float) -> "ImpulseResponse":
        """The part around the maximum that stays above `level` times the maximum, area 1 again."""
        low = self.density < level * self.density.max()
        peak = int(np.argmax(self.density))
        before = np.flatnonzero(low[:peak])
        after = np.flatnonzero(low[peak:])
        first = int(before[-1]) + 1 if len(before) else 0
        end = peak + int(after[0]) if len(after) else len(self.density)
        return from_histogram(self.density[first:end], self.step_s, peak_s=-(self.start_s + first * self.step_s))


def from_histogram(counts: npt.ArrayLike, bin_width_s: float, peak_s: float | None = None) -> ImpulseResponse:
    """A response from a histogram of a single sharp reflection, background already subtracted (negatives become 0).

    Time 0 is `peak_s` after the first edge; by default its maximum (`_maximum`).
    """
    values = np.clip(np.asarray(counts, dtype=np.float64), 0, None)
    if values.ndim != 1 or not np.isfinite(values).all() or not values.sum() > 0:
        raise ValueError("an impulse response needs one row of finite counts, some above 0")
    if peak_s is None:
        peak_s = _maximum(values) * bin_width_s
    return ImpulseResponse(values / (values.sum() * bin_width_s), bin_width_s, -peak_s)


def _maximum(values: Floats) -> float:
    """Where a row of counts has its maximum, in bins from the first edge: that of the parabola through the highest bin
    and two beside it, of means over a sixth of the pulse. Where that is many bins, the highest one is chance."""
    above, running = np.flatnonzero(values >= values.max() / 2), np.append(0.0, np.cumsum(values))
    last = np.searchsorted(running, running[:-1] + running[-1] / 2)
    half = int((last - np.arange(len(values)))[last < len(running)].min())  # the shortest stretch with half of all
    step = int(min((above[-1] - above[0] + 1) / 6, half / 3)) // 2 * 2 + 1
    mean = np.convolve(values, np.ones(step) / step, "same") if step > 1 else values
    top = int(np.argmax(mean))
    beside = mean[np.clip([top - step, top, top + step], 0, len(mean) - 1)]
    return top + 0.5 + step * vertex(*beside)


def vertex(before: float, top: float, after: float) -> float:
    """Where the parabola through three equidistant values has its maximum, in steps from the middle one (+-0.5)."""
    bend = before - 2 * top + after
    return 0.0 if bend >= 0 else float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5))


def stack(
    recorded: npt.NDArray[np.generic], points: Indices, arrivals: Floats, around: tuple[int, int], oversampling: int
) -> Floats:
    """Sum of the histograms (N, T) of `points` (M,) around their arrivals (M,), so many bins before and after them in
    steps of 1 / `oversampling`: arrivals that differ by fractions of a bin let the sum resolve finer than one."""
    before, after = around
    whole = np.floor(arrivals).astype(np.int64)
    steps = np.arange(oversampling) / oversampling
    total = np.zeros((before + after + 1, oversampling))
    for start in range(0, len(whole), ROWS_AT_ONCE):
        rows = slice(start, start + ROWS_AT_ONCE)
        held = windows(recorded, points[rows], whole[rows] - before, before + after + 2)
        running = np.pad(np.cumsum(held, axis=1), ((0, 0), (1, 0)))  # up to whole bins; linear between them
        past = (arrivals - whole)[rows, None] + steps  # (M, oversampling), below 2: bins from those to the steps
        next_bin = past >= 1
        part = past - next_bin
        weights = np.where(next_bin, 0, 1 - part), np.where(next_bin, 1 - part, part), np.where(next_bin, part, 0)
        for ahead, weight in enumerate(weights):
            total += running[:, ahead : ahead + len(total)].T @ weight
    return np.diff(total.reshape(-1)[: (before + after) * oversampling + 1])


def windows(recorded: npt.NDArray[np.generic], points: Indices, first: Indices, length: int) -> Floats:
    """`length` bins from `first` (M,) on in the histograms (N, T) of `points` (M,), shape (M, length), 0 outside of the
    record."""
    index = first[:, None] + np.arange(length)
    inside = (index >= 0) & (index < recorded.shape[1])
    taken = recorded[points[:, None], np.clip(index, 0, recorded.shape[1] - 1)]
    return np.where(inside, taken, 0).astype(np.float64)
