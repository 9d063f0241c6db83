"""Dead time and pile-up undone: the photons that the detector missed because it was still blind from an earlier one.

A histogram's bin can only hold photons of those laser pulses in which the detector was live at that bin. Dividing by
the number of live pulses instead of all pulses gives the photon rate back; a bin that was live L times and clicked
N times saw -ln(1 - N / L) photons per pulse (Coates, J. Phys. E 1, 878, 1968, eq. 4).
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from nlos.calibration.errors import SaturatedBins

Floats = npt.NDArray[np.float64]


def correct_free_running(
    counts: npt.ArrayLike,
    sync_count: npt.ArrayLike,
    total_count: npt.ArrayLike,
    bin_width_s: float,
    period_s: float,
    dead_time_s: float,
) -> tuple[Floats, Floats]:
    """The cyclic correction for a free-running detector, blind for `dead_time_s` after each click.

    `counts` (N, T) from the start of the window, `total_count` (N,) all clicks, also those outside of the window:
    they are taken as spread evenly over the rest of the laser's period, which holds where the window covers all laser
    light. A dead time longer than the period is allowed. Returns counts as a detector without dead time would have
    had them and their variance, (N, T). Raises `SaturatedBins`.
    """
    recorded = np.asarray(counts, dtype=np.float64)
    pulses = _per_point(sync_count, len(recorded))
    blind = blind_pulses(recorded, total_count, bin_width_s, period_s, dead_time_s)
    return _photons(recorded, pulses - blind, pulses)


def blind_pulses(
    counts: npt.ArrayLike, total_count: npt.ArrayLike, bin_width_s: float, period_s: float, dead_time_s: float
) -> Floats:
    """Laser pulses in which the detector was blind in each bin, (N, T): of clicks that are anywhere in the bin one dead
    time before, every other one still blinds."""
    within_s = max(dead_time_s - bin_width_s / 2, 0.0)
    return clicks_before(counts, total_count, bin_width_s, period_s, within_s)


def clicks_before(
    counts: npt.ArrayLike, total_count: npt.ArrayLike, bin_width_s: float, period_s: float, span_s: float
) -> Floats:
    """Clicks within `span_s` before the start of each bin, cyclic in the laser's period, shape (N, T). A record that is
    longer than the period tells them by its first period: later bins are empty, or hold the same clicks once more."""
    recorded = np.asarray(counts, dtype=np.float64)
    points, bins = recorded.shape
    period = period_s / bin_width_s
    held = bins if bins <= period + 0.5 else int(period)
    period = max(period, float(held))
    running = np.empty((points, held + 2))  # clicks before each bin, and before the period's end
    running[:, 0] = 0
    np.cumsum(recorded[:, :held], axis=1, out=running[:, 1:-1])
    running[:, -1] = np.maximum(running[:, -2], _per_point(total_count, points)[:, 0])
    begun = running[:, :bins] if held == bins else _up_to(running, *_look_back(bins, held, period, 0.0))
    return np.asarray(begun - _up_to(running, *_look_back(bins, held, period, span_s / bin_width_s)))


def _up_to(running: Floats, low: npt.NDArray[np.intp], part: Floats, turns: Floats) -> Floats:
    """Clicks before each of the places that `_look_back` found, shape (N, T)."""
    until = running[:, low]
    until += (running[:, low + 1] - until) * part
    until += turns * running[:, -1:]
    return until


@lru_cache(maxsize=16)
def _look_back(bins: int, held: int, period: float, span: float) -> tuple[npt.NDArray[np.intp], Floats, Floats]:
    """Where `span` bins before the start of each bin lies: after which knot, how far between it and the next, and how
    many periods on. Knots are the edges of the `held` bins of one period and the period's end."""
    knots = np.append(np.arange(held + 1.0), period)
    start = np.arange(bins) - span
    turns = np.floor(start / period)
    at = start - turns * period
    low = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, held)
    low[(low == held) & (period == held)] = held - 1
    return low, (at - knots[low]) / (knots[low + 1] - knots[low]), turns


def _photons(recorded: Floats, live: Floats, pulses: Floats) -> tuple[Floats, Floats]:
    full = recorded >= live
    if full.any():
        point, bin_ = (int(i) for i in np.argwhere(full)[0])
        raise SaturatedBins(
            f"point {point}, bin {bin_} clicked {recorded[point, bin_]:.0f} times, but the detector was live there for "
            f"only {live[point, bin_]:.0f} laser pulses: the rate cannot be told. Attenuate the light, or check sync "
            "count and dead time."
        )
    photons = np.log1p(-recorded / live) * -pulses
    return photons, pulses**2 * recorded / (live * (live - recorded))


def _per_point(values: npt.ArrayLike, points: int) -> Floats:
    each = np.asarray(values, dtype=np.float64).reshape(-1, 1)
    return each if len(each) == points else np.broadcast_to(each, (points, 1))
