"""Finds the impulse response in histograms: the most likely arrival, to a fraction of a bin, and its standard error."""

import numpy as np
import numpy.typing as npt
import scipy

from nlos.calibration.by_blocks import some_at_a_time
from nlos.calibration.impulse_response import ROWS_AT_ONCE, ImpulseResponse, Indices, windows

Floats = npt.NDArray[np.float64]
FINE_STEPS = 8
"""Trial shifts a bin; the vertex of a parabola resolves finer."""
DETECTION_NEARBY = 4.0
"""Gain in log-likelihood from which on a pulse is believed within the few bins that are searched."""


def boxcar_arrival(recorded: npt.NDArray[np.generic], background: Floats, box: int) -> tuple[Floats, Floats]:
    """Centre of the fullest `box` bins of each point, and by how much it beats the background in log-likelihood."""
    top, held = np.zeros(len(recorded), dtype=np.int64), np.zeros(len(recorded))
    for rows in some_at_a_time(len(recorded)):
        running = np.pad(np.cumsum(recorded[rows], axis=1, dtype=np.float64), ((0, 0), (1, 0)))
        sums = running[:, box:] - running[:, :-box]
        top[rows], held[rows] = sums.argmax(axis=1), sums.max(axis=1)
    expected = box * background
    gain = held * np.log(np.maximum(held, expected) / expected) - (held - expected)
    return top.astype(np.float64) + box / 2, np.where(held > expected, gain, 0.0)


def earliest_pulse(
    recorded: npt.NDArray[np.generic], together: Indices, background: Floats, box: int, least_gain: float
) -> tuple[Floats, Floats]:
    """As `boxcar_arrival`, of the first `box` bins that beat the background by `least_gain`, moved on to where that
    pulse is fullest: of points `together` (M, K), K at a time."""
    arrival, gain = np.zeros(len(together)), np.zeros(len(together))
    for rows in some_at_a_time(len(together)):
        total = np.zeros((len(together[rows]), recorded.shape[1]))
        for member in together[rows].T:
            total += recorded[member]
        running = np.pad(np.cumsum(total, axis=1), ((0, 0), (1, 0)))
        sums, expected = running[:, box:] - running[:, :-box], box * background[together[rows]].sum(axis=1)[:, None]
        gains = np.where(sums > expected, sums * np.log(np.maximum(sums, expected) / expected) - (sums - expected), 0.0)
        near = np.minimum(np.argmax(gains > least_gain, axis=1)[:, None] + np.arange(box), sums.shape[1] - 1)
        top = np.take_along_axis(near, np.take_along_axis(sums, near, axis=1).argmax(axis=1)[:, None], axis=1)
        arrival[rows], gain[rows] = top[:, 0] + box / 2, np.take_along_axis(gains, top, axis=1)[:, 0]
    return arrival, gain


def later_pulse(
    recorded: npt.NDArray[np.generic], start: Floats, background: Floats, box: int
) -> tuple[Floats, Floats, Floats]:
    """As `boxcar_arrival`, of what comes from `start` (N,) bins on, and its counts above the background."""
    arrival, gain, above = np.zeros((3, len(recorded)))
    for rows in some_at_a_time(len(recorded)):
        rest = np.where(np.arange(recorded.shape[1]) < start[rows, None], 0, recorded[rows])
        arrival[rows], gain[rows] = boxcar_arrival(rest, background[rows], box)
        whole = (arrival[rows] - box / 2).astype(np.int64)
        above[rows] = _held(rest, whole, box) - box * background[rows]
    return arrival, gain, above


def neighbours(x_m: Floats, y_m: Floats, count: int) -> Indices:
    """Indices (N, K) of the `count` points nearest to each, itself included."""
    places = np.column_stack([x_m, y_m])
    nearest = scipy.spatial.cKDTree(places).query(places, min(count, len(places)))[1]
    return np.asarray(nearest, dtype=np.int64).reshape(len(places), -1)


def match(
    recorded: npt.NDArray[np.generic],
    background: Floats,
    centre: Floats,
    template: ImpulseResponse,
    width: float,
    radius: int,
) -> tuple[Floats, Floats]:
    """The most likely arrival within `radius` bins of `centre`, and its standard error: infinite where there is no
    maximum inside, or no more than background under it."""
    before, after = _support(template, width)
    shifts = np.arange(-radius * FINE_STEPS, radius * FINE_STEPS + 1) / FINE_STEPS
    length = before + after + 2 * radius
    shares = template.in_bins(-(before + radius + shifts) * width, length, width)  # (S, length)
    whole = np.floor(centre).astype(np.int64)
    above = _held(recorded, whole - before - radius, length) - length * background
    lit = above > 0  # not those that nobody measured, which may be most of a grid
    signal, below = (float(np.median(each[lit])) if lit.any() else 0.0 for each in (above, background))
    floor = max(below / max(signal, 1e-9), 1e-3 * float(shares.max()))
    weights = np.log1p(shares / floor).T  # (length, S)
    arrival, error, inside = np.zeros(len(whole)), np.zeros(len(whole)), np.zeros(len(whole), bool)
    for rows in some_at_a_time(len(whole), ROWS_AT_ONCE):
        score = windows(recorded[rows], np.arange(len(whole[rows])), whole[rows] - before - radius, length) @ weights
        arrival[rows], error[rows], inside[rows] = _best(score, shifts)
    arrival += whole
    held = window_counts(recorded, arrival, np.zeros_like(background), template, width)
    expected = (before + after) * background
    gain = held * np.log(np.maximum(held, 1e-9) / expected) - (held - expected)
    good = inside & (held > expected) & (gain > DETECTION_NEARBY)
    return arrival, np.where(good, error, np.inf)


def _best(score: Floats, shifts: Floats) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
    """Where each row of log-likelihoods (N, S) has its maximum, its standard error, and whether it lies inside."""
    top = np.argmax(score, axis=1)
    inside = (top > 0) & (top < len(shifts) - 1)
    step = max(FINE_STEPS // 4, 1)
    rows, mid = np.arange(len(score)), np.clip(top, step, len(shifts) - 1 - step)
    low, high, best = score[rows, mid - step], score[rows, mid + step], score[rows, mid]
    bend = np.minimum(low - 2 * best + high, -1e-9)
    turn = np.where(mid == top, np.clip(0.5 * (low - high) / bend, -1, 1), 0.0)
    arrival = shifts[top] + turn * step / FINE_STEPS
    likelihood = np.exp(score - score.max(axis=1, keepdims=True))
    likelihood /= likelihood.sum(axis=1, keepdims=True)
    mean = likelihood @ shifts
    spread = np.sqrt(np.maximum(likelihood @ shifts**2 - mean**2, 0.0))
    several = spread > 1.0  # a few photons fit at several places: their mean is the better guess
    error = np.sqrt((step / FINE_STEPS) ** 2 / -bend)
    return np.where(several, mean, arrival), np.where(several, spread, np.maximum(error, spread)), inside


def window_counts(
    recorded: npt.NDArray[np.generic], at: Floats, background: Floats, template: ImpulseResponse, width: float
) -> Floats:
    """Counts above background under the response placed at `at`; NaN where that is not known."""
    before, after = _support(template, width)
    known = np.isfinite(at)
    whole = np.floor(np.where(known, at, 0)).astype(np.int64)
    total = _held(recorded, whole - before, before + after) - (before + after) * background
    return np.where(known, total, np.nan)


def _held(recorded: npt.NDArray[np.generic], first: Indices, length: int) -> Floats:
    """Counts in `length` bins from `first` (N,) on, (N,)."""
    total = np.zeros(len(first))
    for rows in some_at_a_time(len(first)):
        total[rows] = windows(recorded[rows], np.arange(len(first[rows])), first[rows], length).sum(axis=1)
    return total


def misfit(
    recorded: npt.NDArray[np.generic],
    points: Indices,
    at: Floats,
    background: Floats,
    template: ImpulseResponse,
    width: float,
) -> float:
    """Mean squared deviation of the pulses of `points` (M,) at `at` (M,) from the response scaled to their counts,
    beyond what chance makes, as a share of the response's own squares."""
    before, after = _support(template, width)
    off = power = 0.0
    for rows in some_at_a_time(len(at), ROWS_AT_ONCE):
        whole = np.floor(at[rows]).astype(np.int64)
        held, below = windows(recorded, points[rows], whole - before, before + after), background[rows, None]
        shares = template.in_bins((whole - before - at[rows]) * width, before + after, width)
        pulse = np.clip(held.sum(axis=1, keepdims=True) - (before + after) * below, 0, None) * shares
        off += float(((held - below - pulse) ** 2 - pulse - below).sum())
        power += float((pulse**2).sum())
    return off / max(power, 1e-30)


def _support(template: ImpulseResponse, width: float) -> tuple[int, int]:
    """Bins before and after the arrival that the response reaches into."""
    return int(np.ceil(-template.start_s / width)) + 1, int(np.ceil(template.end_s / width)) + 1
