"""Dead time and pile-up undone: the photons that the detector missed because it was still blind from an earlier one.

A histogram's bin can only hold photons of those laser pulses in which the detector was live at that bin. Dividing by
the number of live pulses instead of all pulses gives the photon rate back; a bin that was live L times and clicked
N times saw -ln(1 - N / L) photons per pulse (Coates, J. Phys. E 1, 878, 1968, eq. 4).
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from nlos.calibration.constants import Quantity
from nlos.calibration.errors import InvalidData, SaturatedBins

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.float32]
_POINTS = 64
"""So many at a time: what is kept of each is a dozen histograms."""
_FLAT = 1e-3
"""Photons per pulse in a bin below which its clicks are all but as even in it as the photons."""
_BRIGHT = 0.01
"""Clicks per pulse in a bin from which on they are taken to be uneven in theirs."""
_MOST = 1 - 1e-9
"""Of the live pulses, in which a bin clicks."""
UNKNOWN = 0.25
"""Where the share of live pulses is not known to this part of itself, a bin's photons are not told."""


def correct_free_running(
    counts: npt.ArrayLike,
    sync_count: npt.ArrayLike,
    total_count: npt.ArrayLike,
    bin_width_s: float,
    period_s: float,
    dead_time_s: Quantity,
) -> tuple[Counts, Counts]:
    """The cyclic correction for a free-running detector, blind for `dead_time_s` after each click.

    `counts` (N, T) from the start of the window, `total_count` (N,) all clicks, also those outside of the window:
    they are taken as spread evenly over the rest of the laser's period, which holds where the window covers all laser
    light. A dead time longer than the period is allowed. Returns counts as a detector without dead time would have
    had them and their variance, (N, T), infinite where nobody can tell: where the dead time of a bright pulse ends, by
    its error and by where in their bins the clicks were, the detector was live for an unknown share of the pulses.
    Raises `SaturatedBins`, and `InvalidData` for a dead time in which the detector has clicked again.
    """
    recorded = np.asarray(counts)
    every, pulses = _per_point(total_count, len(recorded)), _per_point(sync_count, len(recorded))
    dead_s, error_s = dead_time_s.value, dead_time_s.error
    _refuse_too_long(every, pulses * period_s, dead_time_s)
    photons, variance = np.empty((2, *recorded.shape), dtype=np.float32)
    for some in _some_at_a_time(len(recorded)):
        clicks = recorded[some].astype(np.float64)

        def blind(span_s: float, clicks: Floats = clicks, some: slice = some) -> Floats:
            return blind_pulses(clicks, every[some], bin_width_s, period_s, span_s, pulses[some])

        unsure = _ends_somewhere(clicks, dead_s / bin_width_s, period_s / bin_width_s)
        if error_s > 0:
            unsure = np.hypot(unsure, (blind(dead_s + error_s) - blind(max(dead_s - error_s, 0.0))) / 2)
        live = pulses[some] - blind(dead_s)
        unknown = unsure > UNKNOWN * live
        _refuse_full((clicks >= live) & ~unknown, clicks, live, some.start)
        photons[some], variance[some] = _photons(clicks, live, pulses[some], unsure)
        variance[some][unknown] = np.inf
    return photons, variance


def blind_pulses(
    counts: npt.ArrayLike,
    total_count: npt.ArrayLike,
    bin_width_s: float,
    period_s: float,
    dead_time_s: float,
    sync_count: npt.ArrayLike = np.inf,
) -> Floats:
    """Laser pulses in which the detector was blind by an earlier bin's click, on average over each bin, (N, T).

    Within a bin photons come evenly and so do clicks of faint light; of bright light, as `sync_count` (N,) pulses tell
    it, the first photon makes the click, which falls off as exp(-photons per pulse until then).
    """
    recorded = np.asarray(counts, dtype=np.float64)
    points, bins = recorded.shape
    total, pulses = _per_point(total_count, points), _per_point(sync_count, points)
    blind = np.empty((points, bins))
    for some in _some_at_a_time(points):
        clicks = _Period(recorded[some], total[some], period_s / bin_width_s)
        blind[some] = clicks.blind(dead_time_s / bin_width_s)
        if (recorded[some].max(axis=1, keepdims=True) > _BRIGHT * pulses[some]).any():
            part = recorded[some] / np.maximum(pulses[some] - blind[some], 1e-300)
            blind[some] = clicks.blind(dead_time_s / bin_width_s, -np.log1p(-np.clip(part, 0.0, _MOST)))
    return blind


def _refuse_too_long(clicks: Floats, took_s: Floats, dead_time: Quantity) -> None:
    """Of a unit that was taken for another: no pulse would be left in which the detector was live, and the light that
    was recorded would be called none."""
    clicked = (clicks > 0) & (took_s > 0)
    apart_s = np.median(took_s[clicked] / clicks[clicked]) if clicked.any() else np.inf
    if dead_time.value - 3 * dead_time.error > apart_s:
        raise InvalidData(
            f"a dead time of {dead_time.value * 1e9:g} ns cannot be: at every other point a click comes each "
            f"{apart_s * 1e9:.4g} ns. Is it told in nanoseconds?"
        )


class _Period:
    """The clicks of one period of each point, cyclic. Knots are the edges of its bins and the period's end. A record
    that is longer than the period tells them by its first period: later bins are empty, or hold the same once more."""

    def __init__(self, recorded: Floats, total: Floats, period: float) -> None:
        points, self._bins = recorded.shape
        self._held = self._bins if self._bins <= period + 0.5 else int(period)
        self._period = max(period, float(self._held))
        self._running = np.empty((points, self._held + 2))  # clicks before each knot
        self._running[:, 0] = 0
        np.cumsum(recorded[:, : self._held], axis=1, out=self._running[:, 1:-1])
        self._running[:, -1] = np.maximum(self._running[:, -2], total[:, 0])

    def blind(self, dead: float, photons: Floats | None = None) -> Floats:
        """Clicks of earlier bins within `dead` bins before a place in each bin, on average over the bin, (N, T).
        `photons` (N, T) per pulse shape the clicks within their bins."""
        within = min(dead, 1.0)  # of a shorter dead time, what is later in the bin is not blind
        running, held = self._running, self._held
        rate = None if photons is None else np.pad(photons[:, :held], ((0, 0), (0, 1)))
        knots = np.append(np.arange(held + 1.0), self._period)
        inside = running[:, :-1] * np.diff(knots) + np.diff(running) * np.diff(knots) * _until(rate, 1.0)
        area = np.pad(np.cumsum(inside, axis=1), ((0, 0), (1, 0)))  # of the running clicks before each knot
        begun = running[:, : self._bins]
        if held != self._bins:
            low, part, turns = _look_back(self._bins, held, self._period, 0.0)
            begun = running[:, low] + (running[:, low + 1] - running[:, low]) * part + turns * running[:, -1:]
        early, late = (self._area(area, rate, knots, span) for span in (dead, dead - within))
        return np.asarray(within * begun - (late - early))

    def _area(self, area: Floats, rate: Floats | None, knots: Floats, span: float) -> Floats:
        """Integral of the running clicks up to `span` before each bin's start, continued over the periods, (N, T)."""
        low, part, turns = _look_back(self._bins, self._held, self._period, span)
        width, running = np.diff(knots)[low], self._running
        step = running[:, low + 1] - running[:, low]
        shape = _until(None if rate is None else rate[:, low], part)
        until = area[:, low] + width * (running[:, low] * part + step * shape)
        place = knots[low] + part * width
        whole = turns * place + self._period * turns * (turns - 1) / 2
        return np.asarray(until + turns * area[:, -1:] + whole * running[:, -1:])


def _until(photons: Floats | None, part: Floats | float) -> Floats:
    """Integral up to `part` of a bin of the share of its clicks that came before. Of `photons` per pulse in it, the
    first one's place is exponential within the bin; of faint light it is even."""
    even = np.asarray(np.square(part) / 2)
    if photons is None:
        return even
    bright = np.maximum(photons, _FLAT)
    first = (part + np.expm1(-bright * part) / bright) / -np.expm1(-bright)
    return np.asarray(np.where(photons < _FLAT, even + photons * (even / 2 - np.power(part, 3) / 6), first))


def _ends_somewhere(recorded: Floats, dead: float, period: float) -> Floats:
    """Standard error of the blind pulses (N, T) by where within their bins clicks were: of a pulse in one bin anywhere,
    of light that its neighbours share as even as they are. Given by the second difference of neighbours, a twelfth of
    their slope, and the bins in which the dead time of each ends."""
    if not dead > 0:
        return np.zeros_like(recorded)
    bins = recorded.shape[1]
    beside = np.pad(recorded, ((0, 0), (1, 1)))
    slope = (beside[:, 2:] - beside[:, :-2]) / 24
    bend = (beside[:, 2:] - 2 * recorded + beside[:, :-2]) / np.sqrt(48)
    own = np.hypot(slope, bend)
    back = (np.arange(bins) - dead) % period
    low = np.floor(back).astype(np.int64)
    part = back - low
    held = np.pad(own, ((0, 0), (0, 2)))
    near, far = held[:, np.minimum(low, bins)], held[:, np.minimum(low + 1, bins)]
    return np.asarray(np.hypot((1 - part) * near, part * far * (dead >= 1)))  # a bin's own clicks are not earlier ones


@lru_cache(maxsize=64)
def _look_back(bins: int, held: int, period: float, span: float) -> tuple[npt.NDArray[np.intp], Floats, Floats]:
    """Where `span` bins before the start of each bin lies: after which knot, how far between it and the next, and how
    many periods on."""
    knots = np.append(np.arange(held + 1.0), period)
    start = np.arange(bins) - span
    turns = np.floor(start / period)
    at = start - turns * period
    low = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, held)
    low[(low == held) & (period == held)] = held - 1
    return low, (at - knots[low]) / (knots[low + 1] - knots[low]), turns


def _refuse_full(full: npt.NDArray[np.bool_], clicks: Floats, live: Floats, first: int) -> None:
    if full.any():
        point, bin_ = (int(i) for i in np.argwhere(full)[0])
        raise SaturatedBins(
            f"point {first + point}, bin {bin_} clicked {clicks[point, bin_]:.0f} times, but the detector was live "
            f"there for only {live[point, bin_]:.0f} laser pulses: the rate cannot be told. Attenuate the light, or "
            "check sync count and dead time."
        )


def _photons(clicks: Floats, live: Floats, pulses: Floats, unsure: Floats) -> tuple[Floats, Floats]:
    """Photons and their variance by the counts' chance and by the error of the live pulses; 0 of bins as full as can
    be."""
    full = clicks >= live
    clicks, live = np.where(full, 0.0, clicks), np.where(full, 1.0, live)
    chance = clicks / (live * (live - clicks))
    return np.log1p(-clicks / live) * -pulses, pulses**2 * (chance + (unsure * chance) ** 2)


def _some_at_a_time(points: int) -> list[slice]:
    return [slice(first, first + _POINTS) for first in range(0, points, _POINTS)]


def _per_point(values: npt.ArrayLike, points: int) -> Floats:
    each = np.asarray(values, dtype=np.float64).reshape(-1, 1)
    return each if len(each) == points else np.broadcast_to(each, (points, 1))
