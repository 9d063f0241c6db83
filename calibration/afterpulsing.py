"""What a detector does after a click: how long it is blind, and how often it clicks again without a photon."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import curve_fit

from calibration.errors import InvalidData

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ClickAfterClick:
    """Dead time and afterpulsing with standard errors. Afterpulses follow the dead time, falling as exp(-t / decay)."""

    dead_time_s: float
    dead_time_error_s: float
    afterpulse_probability: float
    afterpulse_error: float
    decay_s: float


def from_arrival_times(arrival_s: npt.ArrayLike, longest_s: float = 1e-6, step_s: float = 1e-9) -> ClickAfterClick:
    """From the clicks' absolute times in order (time tags under steady light): the intervals' hazard rate.

    The hazard is 0 within the dead time and the photon rate long after; what lies above that in between are
    afterpulses. Raises `InvalidData` below 1000 intervals.
    """
    intervals = np.diff(np.asarray(arrival_s, dtype=np.float64))
    if len(intervals) < 1000 or (intervals < 0).any():
        raise InvalidData(f"{len(intervals)} intervals in order of time are given; at least 1000 are needed.")
    edges = np.arange(round(longest_s / step_s) + 1) * step_s
    clicks = np.histogram(intervals, edges)[0].astype(np.float64)
    at_risk = len(intervals) - np.concatenate([[0.0], np.cumsum(clicks)[:-1]])
    dead = float(np.sort(intervals)[len(intervals) // 100_000])
    used = (at_risk > 100) & (edges[:-1] >= dead)
    time, hazard = edges[:-1][used] + step_s / 2 - dead, clicks[used] / at_risk[used] / step_s
    error = np.sqrt(np.maximum(clicks[used], 1)) / at_risk[used] / step_s
    start = (float(np.median(hazard)), 0.02, 30e-9)
    bounds = ([0, 0, step_s], [np.inf, 1, longest_s])
    (rate, probability, decay), covariance = curve_fit(_hazard, time, hazard, start, error, True, bounds=bounds)
    first_clicks_per_s = (rate + probability / decay) * len(intervals)
    return ClickAfterClick(
        dead, float(1 / first_clicks_per_s), float(probability), float(np.sqrt(covariance[1, 1])), float(decay)
    )


def _hazard(time_s: Floats, photon_rate: float, probability: float, decay_s: float) -> Floats:
    return np.asarray(photon_rate + probability / decay_s * np.exp(-time_s / decay_s))


def from_full_period(
    counts: npt.ArrayLike,
    sync_count: float,
    bin_width_s: float,
    quiet: npt.ArrayLike,
    dead_times_s: npt.ArrayLike,
    decays_s: npt.ArrayLike,
) -> ClickAfterClick:
    """From one histogram over the laser's whole period, `counts` (T,): the detector is less live for one dead time
    after the pulse, and clicks more afterwards.

    `quiet` (T,) marks the bins that hold constant background only. Tries all dead times and decays given and fits
    background and afterpulse probability under each by weighted least squares; the error of the dead time is where
    chi squared has risen by 1. Raises `InvalidData` where nothing tells one dead time from another.
    """
    recorded = np.asarray(counts, dtype=np.float64)
    where = np.asarray(quiet, dtype=bool)
    bins = len(recorded)
    spectrum = np.fft.rfft(recorded / sync_count)
    turn = np.arange(bins) * bin_width_s
    period = bins * bin_width_s
    frequencies = np.fft.rfftfreq(bins, bin_width_s)
    dead_times, decays = np.asarray(dead_times_s, dtype=np.float64), np.asarray(decays_s, dtype=np.float64)
    running = np.concatenate([[0.0], np.cumsum(recorded)])
    best: dict[float, tuple[float, float, float, float]] = {}
    for dead in dead_times:
        start = np.arange(bins) - dead / bin_width_s
        turns = np.floor(start / bins)
        until = np.interp(start - turns * bins, np.arange(bins + 1), running)
        live = 1 - (running[:-1] - until - turns * running[-1]) / sync_count
        for decay in decays:
            kernel = np.exp(-turn / decay)
            kernel /= kernel.sum()
            shifted = np.fft.rfft(kernel) * np.exp(-2j * np.pi * frequencies * (dead % period))
            after = np.fft.irfft(spectrum * shifted, bins)
            columns = (np.column_stack([np.ones(bins), after]) * (live * sync_count)[:, None])[where]
            weight = 1 / np.maximum(np.mean(recorded[where]), 1.0)
            normal = columns.T @ columns * weight
            solution = np.linalg.lstsq(normal, columns.T @ recorded[where] * weight, rcond=None)[0]
            chi2 = float((((recorded[where] - columns @ solution) ** 2) * weight).sum())
            if dead not in best or chi2 < best[dead][0]:
                error = float(np.sqrt(max(np.linalg.pinv(normal)[1, 1], 0.0)))
                best[dead] = (chi2, float(solution[1]), error, float(decay))
    chi2s = np.array([best[dead][0] for dead in dead_times])
    least = int(np.argmin(chi2s))
    if not np.ptp(chi2s) > 9:
        raise InvalidData(
            f"no dead time between {dead_times[0]:.3g} and {dead_times[-1]:.3g} s explains the histogram better than "
            "another. Record a longer or brighter histogram over the whole laser period."
        )
    within = dead_times[chi2s <= chi2s[least] + 1]
    spacing = float(np.median(np.diff(dead_times))) if len(dead_times) > 1 else 0.0
    _, probability, error, decay_s = best[dead_times[least]]
    return ClickAfterClick(
        float(dead_times[least]), max(float(np.ptp(within)) / 2, spacing / 2), probability, error, decay_s
    )


def subtract_afterpulses(
    counts: npt.ArrayLike, probability: float, decay_s: float, dead_time_s: float, bin_width_s: float
) -> Floats:
    """Counts (N, P) over the laser's whole period less the afterpulses expected from all clicks in it, cyclically."""
    recorded = np.asarray(counts, dtype=np.float64)
    bins = recorded.shape[1]
    kernel = np.exp(-np.arange(bins) * bin_width_s / decay_s)
    kernel *= probability / kernel.sum()
    delay = np.exp(-2j * np.pi * np.fft.rfftfreq(bins, bin_width_s) * (dead_time_s % (bins * bin_width_s)))
    expected = np.fft.irfft(np.fft.rfft(recorded, axis=1) * np.fft.rfft(kernel) * delay, bins, axis=1)
    return recorded - expected
