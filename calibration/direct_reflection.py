"""The light that comes straight back from the wall: found, modelled and taken out of aligned histograms.

Time 0 of aligned histograms is the direct arrival. The pulse decays through the detector's tail; the hidden object
adds counts later on. Where the pulse outshines whatever else there is, bins are masked; behind that, the tail's
model is subtracted and its variance stays. Nothing is destroyed: model and mask are results of their own.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.calibration.close_pulse import ClosePulse, close_pulse

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.float32]
SMOOTHING_S = 60e-12
PRESENT_WITHIN_S = 200e-12
"""A direct pulse has its maximum this close to time 0 ..."""
PRESENT_ABOVE = 3.0
"""... and is this many times brighter than anything a nanosecond later, or than what is darkest until then."""
LEAST_PRESENT = 0.1
"""Of the brightest later return, which may well outshine it: of a gated detector, or of an object near the wall."""
MASKED_ABOVE = 0.3
"""Bins are masked where the direct light's model exceeds this share of the brightest later return."""
FAINTEST = 1e-4
"""Share of the pulse's maximum below which its tail is not masked, even where no later return is seen."""


@dataclass(frozen=True)
class DirectLight:
    """The model of the direct light: `amplitude` (N,) photons of `shape` (T,), and where it hides everything else."""

    shape: Floats
    """Share of the direct photons in each bin; extrapolated as an exponential behind the last clean bin."""
    amplitude: Floats
    end_bin: int
    """Bins before this one are masked; 0 where there is no direct light."""
    decay_bins: float
    """Time constant of the extrapolated tail; 0 where the tail is not seen."""
    close: ClosePulse | None = None
    """A second pulse that is masked with it."""

    def close_end_bin(self) -> int:
        """Where that ends; 0 without one."""
        return 0 if self.close is None else self.close.end_bin

    def counts(self) -> Counts:
        """Expected direct counts, shape (N, T)."""
        return np.multiply.outer(self.amplitude, self.shape).astype(np.float32)

    def usable(self) -> npt.NDArray[np.bool_]:
        """False in the masked bins, shape (T,)."""
        return np.asarray(np.arange(len(self.shape)) >= self.end_bin)


def find_direct_light(aligned: npt.ArrayLike, bin_width_s: float, *, mask_close: bool = True) -> DirectLight:
    """Models the direct light of histograms (N, T) aligned to its arrival, background subtracted. `mask_close`: whether
    a second pulse close behind it is masked with it."""
    counts = np.asarray(aligned, dtype=np.float32)
    points, bins = counts.shape
    mean = counts.mean(axis=0, dtype=np.float64)
    smooth = _smoothed(mean, max(3, round(SMOOTHING_S / bin_width_s) | 1))
    noise = np.sqrt(np.maximum(smooth, smooth.max() * 1e-9) / points)
    early = max(2, round(PRESENT_WITHIN_S / bin_width_s))
    late = round(1e-9 / bin_width_s)
    nothing = DirectLight(np.zeros(bins), np.zeros(points), 0, 0.0)
    if bins <= late + early or not smooth[:early].max() > 0:
        return nothing
    peak = int(np.argmax(smooth[:early]))
    dip, later_peak = float(smooth[peak : late + 1].min()), float(smooth[late:].max())
    stands_alone = smooth[peak] > max(PRESENT_ABOVE * dip, LEAST_PRESENT * later_peak, 5 * noise[peak])
    if smooth[peak] < PRESENT_ABOVE * later_peak and not stands_alone:
        return nothing
    turn = _first_rise(smooth, noise, peak)
    close = close_pulse(counts, smooth, (peak, turn), bin_width_s) if mask_close else None
    if close is not None:
        turn = _first_rise(smooth, noise, close.end_bin - 1)
    lowest = max(float(smooth[turn]), 3 * float(noise[turn]), FAINTEST * float(smooth[peak]) / 3)
    clean_end = _first_below(smooth, 3 * lowest, peak)
    tail_start = max(_first_below(smooth, min(30 * lowest, 0.3 * smooth[peak]), peak), peak + 1)
    shape = np.where(np.arange(bins) < clean_end, np.clip(mean, 0, None), 0.0)
    decay = _decay_bins(mean[tail_start:clean_end])
    if decay > 0:
        level = mean[tail_start:clean_end].sum() / np.exp(-np.arange(tail_start, clean_end) / decay).sum()
        shape[clean_end:] = level * np.exp(-np.arange(clean_end, bins) / decay)
    later = smooth[turn:] - shape[turn:]
    brightest = float(later.max())
    if brightest < 5 * float(noise[turn + int(np.argmax(later))]):
        brightest = 0.0
    limit = max(MASKED_ABOVE * brightest, FAINTEST * float(smooth[peak]))
    above = np.flatnonzero(_smoothed(shape, max(3, round(SMOOTHING_S / bin_width_s) | 1)) > limit)
    end = min(int(above[-1]) + 1 if len(above) else 0, max(turn, peak + 1))
    shape /= shape.sum()
    core = slice(0, max(tail_start, 1))
    amplitude = counts[:, core].sum(axis=1, dtype=np.float64) / shape[core].sum()
    if decay > 0:  # the tail need not scale as the pulse: let each point's own counts say so, as far as there are any
        expected = amplitude * shape[tail_start:clean_end].sum()
        seen = counts[:, tail_start:clean_end].sum(axis=1, dtype=np.float64)
        amplitude = amplitude * np.clip(seen + 30, 0, None) / (np.clip(expected, 0, None) + 30)
    if close is not None:
        end = max(end, close.end_bin)
    return DirectLight(shape, np.clip(amplitude, 0, None), end, decay, close)


def known_direct_light(aligned: npt.ArrayLike, shape: Floats, end_bin: int) -> DirectLight:
    """The direct light of histograms (N, T) where an earlier scan tells its shape: only the amplitude is new."""
    counts = np.asarray(aligned, dtype=np.float32)
    fitting = np.zeros(counts.shape[1])
    fitting[: len(shape)] = shape[: len(fitting)]
    share = max(float(fitting[:end_bin].sum()), 1e-12)
    amplitude = np.clip(counts[:, :end_bin].sum(axis=1, dtype=np.float64) / share, 0, None)
    return DirectLight(fitting, amplitude, end_bin, 0.0)


def remove_direct_light(aligned: npt.ArrayLike, direct: DirectLight) -> Counts:
    """Histograms (N, T) with masked bins 0 and the tail's model subtracted behind them."""
    return np.where(direct.usable(), np.asarray(aligned, dtype=np.float32) - direct.counts(), np.float32(0))


def _smoothed(values: Floats, length: int) -> Floats:
    padded = np.pad(values, length // 2, mode="edge")
    running = np.concatenate([[0.0], np.cumsum(padded)])
    return np.asarray((running[length:] - running[:-length]) / length)


def _first_below(values: Floats, level: float, start: int) -> int:
    below = np.flatnonzero(values[start:] < level)
    return start + int(below[0]) if len(below) else len(values)


def _first_rise(smooth: Floats, noise: Floats, peak: int) -> int:
    """The minimum before the first significant rise behind the peak: where other light begins to matter."""
    lowest = np.minimum.accumulate(smooth[peak:])
    rising = np.flatnonzero(smooth[peak:] > 1.5 * np.maximum(lowest, 0) + 5 * noise[peak:])
    end = peak + int(rising[0]) if len(rising) else len(smooth)
    return peak + int(np.argmin(smooth[peak:end]))


def _decay_bins(tail: Floats) -> float:
    """Time constant of a decaying stretch by a straight line through its logarithm, weighted by counts; 0 where the
    stretch is too short or does not decay."""
    good = tail > 0
    if good.sum() < 8:
        return 0.0
    slope = float(np.polyfit(np.flatnonzero(good), np.log(tail[good]), 1, w=np.sqrt(tail[good]))[0])
    return -1 / slope if -slope * len(tail) > 1 else 0.0
