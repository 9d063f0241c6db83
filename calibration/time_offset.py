"""When the direct light of every point arrives, to a fraction of a bin: a matched filter, held together by the wall.

Each point's arrival maximises the Poisson likelihood of its counts under the impulse response on a constant
background, which is a matched filter with the logarithm of the response. The response is measured from the data
where none is given: points are stacked at their arrivals, finer than the bins, and both improve in turn. The joint
fit of wall and scanner bridges points with few counts and outliers.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition.transient import TimeAxis
from calibration.errors import NoDirectPeak
from calibration.impulse_response import ImpulseResponse, from_histogram, stack
from calibration.wall_timing import WallTiming, fit_wall_timing

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
ROUNDS = 6
OVERSAMPLING = 4
"""Steps a bin of a response that is measured from the data."""
FINE_STEPS = 8
"""Trial shifts a bin of the matched filter; the vertex of a parabola resolves finer."""
BOX_S = 100e-12
DETECTION = 12.0
"""Gain in log-likelihood from which on a pulse is believed anywhere in the record (by chance: 1e-5 a bin)."""
DETECTION_NEAR_WALL = 4.0
"""The same where the wall says within a few bins when to expect it."""
SMALLEST_RADIUS_BINS = 4


@dataclass(frozen=True)
class TimeOffsets:
    """Arrival of direct light in bins after the start of the record, per point, all arrays (N,)."""

    offset_bins: Floats
    """What to align by: measured and predicted arrival weighed by their errors; NaN where there is neither."""
    measured_bins: Floats
    """The matched filter alone; NaN where it found nothing."""
    error_bins: Floats
    """Standard error of `measured_bins`, infinite where nothing was found."""
    predicted_bins: Floats
    """By the joint fit of wall, scanner and delay; NaN without one."""
    direct_counts: Floats
    """Photons in the direct pulse above background."""
    background_per_bin: Floats
    wall: WallTiming | None
    """None where the points cannot tell (fewer than nine, or on one line)."""
    response: ImpulseResponse

    @property
    def found(self) -> Flags:
        return np.isfinite(self.error_bins)

    @property
    def residual_bins(self) -> Floats:
        """Measured arrival less the wall's prediction."""
        return self.measured_bins - self.predicted_bins

    @property
    def rms_bins(self) -> float:
        """Scatter about the wall of the measurements that the fit accepted; NaN without a wall."""
        if self.wall is None:
            return float("nan")
        return float(np.sqrt(np.mean(self.residual_bins[self.wall.accepted & self.found] ** 2)))


def measure_time_offsets(
    counts: npt.ArrayLike,
    x_m: npt.ArrayLike,
    y_m: npt.ArrayLike,
    time: TimeAxis,
    response: ImpulseResponse | None = None,
    exposed: npt.ArrayLike | None = None,
) -> TimeOffsets:
    """The arrival of direct light at every point.

    `counts` (N, T) raw, `x_m` and `y_m` (N,) on the wall, `exposed` (N,) False for points that were not measured.
    Raises `NoDirectPeak` where no point shows a pulse.
    """
    recorded = np.asarray(counts)
    x, y = np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
    lit = np.ones(len(recorded), bool) if exposed is None else np.asarray(exposed, dtype=bool)
    width = time.bin_width_s
    background = quiet_background(recorded)
    box = max(3, round(BOX_S / width))
    first, gain = _boxcar_arrival(recorded, background, box)
    bright = lit & (gain > DETECTION)
    if not bright.any():
        best = int(np.argmax(gain))
        raise NoDirectPeak(
            f"no direct peak in any of {int(lit.sum())} points: the best, point {best}, stands out of its background "
            f"by {gain[best]:.1f} in log-likelihood, and {DETECTION:.0f} is needed. Check shutter and laser, and "
            "whether the time window covers the wall."
        )
    arrival, error = first, np.where(bright, box / 3.5, np.inf)
    template, radius = response, 3 * box
    for number in range(ROUNDS):
        wall = fit_wall_timing(time.start_s + arrival * width, error * width, x, y)
        predicted = _predicted(wall, x, y, time)
        centre = _centre(arrival, error, wall, predicted, first)
        if response is None:
            trusted = np.isfinite(error) & (wall.accepted if wall else True)
            template = _stacked_response(recorded[trusted], centre[trusted], background[trusted], width)
        assert template is not None
        previous = arrival
        arrival, error = _match(recorded, background, centre, template, width, radius)
        error[~lit] = np.inf
        shift = np.abs(arrival - previous)[np.isfinite(error)]
        if number > 1 and len(shift) and np.quantile(shift, 0.9) < 0.03:
            break
        scatter = wall.rms_s / width if wall else 0.0
        radius = int(np.clip(np.ceil(6 * scatter), SMALLEST_RADIUS_BINS, 3 * box))
    assert template is not None
    wall = fit_wall_timing(time.start_s + arrival * width, error * width, x, y)
    predicted = _predicted(wall, x, y, time)
    direct = _window_counts(recorded, np.where(np.isfinite(error), arrival, predicted), background, template, width)
    elsewhere = np.zeros(len(recorded), bool)
    if wall is not None:  # as bright a pulse as the others', but far from the fitted plane: there the wall is not plane
        aside, aside_error = _match(recorded, background, first, template, width, 3 * box)
        aside_counts = _window_counts(recorded, aside, background, template, width)
        typical = np.median(direct[np.isfinite(error)]) if np.isfinite(error).any() else 0.0
        elsewhere = ~np.isfinite(error) & bright & np.isfinite(aside_error) & (aside_counts > 0.5 * typical)
        arrival, error = np.where(elsewhere, aside, arrival), np.where(elsewhere, aside_error, error)
        direct = np.where(elsewhere, aside_counts, direct)
    return TimeOffsets(
        offset_bins=np.where(elsewhere, arrival, _weighed(arrival, error, wall, predicted, width)),
        measured_bins=np.where(np.isfinite(error), arrival, np.nan),
        error_bins=error,
        predicted_bins=predicted,
        direct_counts=direct,
        background_per_bin=background,
        wall=wall,
        response=template,
    )


def quiet_background(counts: npt.ArrayLike) -> Floats:
    """Counts per bin away from any light, shape (N,): the mean over those sixteenths of the record that are the
    quietest quarter on average over all points, drawn towards all points' mean where counts are few."""
    recorded = np.asarray(counts)
    points, bins = recorded.shape
    edges = np.linspace(0, bins, min(16, bins) + 1).astype(int)
    totals = np.add.reduceat(recorded, edges[:-1], axis=1, dtype=np.float64)  # (N, blocks)
    quiet = np.argsort(totals.mean(axis=0) / np.diff(edges))[: max(1, len(edges) // 4)]
    length = np.diff(edges)[quiet].sum()
    pooled = max(totals[:, quiet].sum() / (length * points), 1e-9)
    return np.asarray((totals[:, quiet].sum(axis=1) + 1) / (length + 1 / pooled))


def _boxcar_arrival(recorded: npt.NDArray[np.generic], background: Floats, box: int) -> tuple[Floats, Floats]:
    """Centre of the fullest `box` bins of each point, and by how much it beats the background in log-likelihood."""
    arrival, gain = np.zeros(len(recorded)), np.zeros(len(recorded))
    for row, histogram in enumerate(recorded):
        running = np.concatenate([[0.0], np.cumsum(histogram, dtype=np.float64)])
        sums = running[box:] - running[:-box]
        top = int(np.argmax(sums))
        expected = box * background[row]
        if sums[top] > expected:
            gain[row] = sums[top] * np.log(sums[top] / expected) - (sums[top] - expected)
        arrival[row] = top + box / 2
    return arrival, gain


def _predicted(wall: WallTiming | None, x: Floats, y: Floats, time: TimeAxis) -> Floats:
    return np.full(len(x), np.nan) if wall is None else (wall.arrival_s(x, y) - time.start_s) / time.bin_width_s


def _centre(arrival: Floats, error: Floats, wall: WallTiming | None, predicted: Floats, first: Floats) -> Floats:
    """Where to look next: at the wall's prediction for outliers and points without a pulse."""
    if wall is None:
        return np.where(np.isfinite(error), arrival, first)
    return np.where(wall.accepted, arrival, predicted)


def _weighed(arrival: Floats, error: Floats, wall: WallTiming | None, predicted: Floats, width: float) -> Floats:
    """The mean of measurement and prediction weighed by their variances; the wall's own roughness is what the scatter
    about it holds beyond the measurements' errors."""
    if wall is None:
        return np.where(np.isfinite(error), arrival, np.nan)
    typical = float(np.median(error[wall.accepted]))
    roughness = max((wall.rms_s / width) ** 2 - typical**2, (0.25 * typical) ** 2, 1e-4)
    trust = np.where(np.isfinite(error), roughness / (roughness + error**2), 0.0)
    return np.where(trust > 0, trust * arrival + (1 - trust) * predicted, predicted)


def _stacked_response(
    recorded: npt.NDArray[np.generic], at: Floats, background: Floats, width: float
) -> ImpulseResponse:
    """The pulse on a grid finer than the bins, down to 2 % of its maximum."""
    bins = recorded.shape[1]
    before, after = min(bins, round(1e-9 / width) + 2), min(bins, round(3e-9 / width) + 4)
    total = stack(recorded, at, before, after, OVERSAMPLING) - background.sum() / OVERSAMPLING
    return from_histogram(total, width / OVERSAMPLING).cropped(0.02)


def _support(template: ImpulseResponse, width: float) -> tuple[int, int]:
    """Bins before and after the arrival that the response reaches into."""
    return int(np.ceil(-template.start_s / width)) + 1, int(np.ceil(template.end_s / width)) + 1


def _windows(recorded: npt.NDArray[np.generic], first: npt.NDArray[np.int64], length: int) -> Floats:
    """`length` bins from `first` on, shape (N, length), 0 outside of the record."""
    index = first[:, None] + np.arange(length)
    inside = (index >= 0) & (index < recorded.shape[1])
    taken = np.take_along_axis(recorded, np.clip(index, 0, recorded.shape[1] - 1), axis=1)
    return np.where(inside, taken, 0).astype(np.float64)


def _match(
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
    whole = np.floor(centre).astype(np.int64)
    shifts = np.arange(-radius * FINE_STEPS, radius * FINE_STEPS + 1) / FINE_STEPS
    length = before + after + 2 * radius
    shares = template.in_bins(-(before + radius + shifts) * width, length, width)  # (S, length)
    windows = _windows(recorded, whole - before - radius, length)
    signal = windows.sum(axis=1) - length * background
    floor = max(float(np.median(background) / max(np.median(signal), 1e-9)), 1e-3 * float(shares.max()))
    score = windows @ np.log1p(shares / floor).T  # (N, S)
    top = np.argmax(score, axis=1)
    inside = (top > 0) & (top < len(shifts) - 1)
    step = max(FINE_STEPS // 4, 1)
    rows, mid = np.arange(len(recorded)), np.clip(top, step, len(shifts) - 1 - step)
    low, high, best = score[rows, mid - step], score[rows, mid + step], score[rows, mid]
    bend = np.minimum(low - 2 * best + high, -1e-9)
    turn = np.where(mid == top, np.clip(0.5 * (low - high) / bend, -1, 1), 0.0)
    arrival = whole + shifts[top] + turn * step / FINE_STEPS
    error = np.sqrt((step / FINE_STEPS) ** 2 / -bend)
    held = _window_counts(recorded, arrival, np.zeros_like(background), template, width)
    expected = (before + after) * background
    gain = held * np.log(np.maximum(held, 1e-9) / expected) - (held - expected)
    good = inside & (held > expected) & (gain > DETECTION_NEAR_WALL)
    return arrival, np.where(good, error, np.inf)


def _window_counts(
    recorded: npt.NDArray[np.generic], at: Floats, background: Floats, template: ImpulseResponse, width: float
) -> Floats:
    """Counts above background under the response placed at `at`; NaN where that is not known."""
    before, after = _support(template, width)
    known = np.isfinite(at)
    whole = np.floor(np.where(known, at, 0)).astype(np.int64)
    total = _windows(recorded, whole - before, before + after).sum(axis=1) - (before + after) * background
    return np.where(known, total, np.nan)
