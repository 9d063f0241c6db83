"""Arrivals of light refined in rounds, from where each point's pulse was first seen: filter, response and wall in turn.

Each point's arrival maximises the Poisson likelihood of its counts under the impulse response on a constant
background, which is a matched filter with the logarithm of the response. The response is measured from the data
where none is given: points are stacked at their arrivals, finer than the bins, and both improve in turn. The joint
fit of wall and scanner bridges points with few counts and outliers.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.calibration.background import is_flat
from nlos.calibration.by_blocks import chosen
from nlos.calibration.drawn_wall import fit_near_drawing
from nlos.calibration.errors import NoDirectPeak, ShutterClosed
from nlos.calibration.impulse_response import ImpulseResponse, from_histogram, stack
from nlos.calibration.matched_filter import match, window_counts
from nlos.calibration.wall_timing import WallTiming, fit_wall_timing

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
ROUNDS = 6
OVERSAMPLING = 4
"""Steps a bin of a response that is measured from the data."""
WIDEST_PULSE_S = 1e-9
DETECTION = 12.0
"""Gain in log-likelihood from which on a pulse is believed anywhere in the record (by chance: 1e-5 a bin)."""
FEWEST_SHARE = 0.1
"""Of the points: where fewer show a pulse, chance made it."""
SMALLEST_RADIUS_BINS = 4
SMALLEST_RADIUS = 0.125
"""Of the response's width, whose maximum moves as it is measured anew."""
PLANE_S = 25e-12
"""Direct light scatters by no more about a plane wall, or than half a bin, or twice its own error: 1 to 10 ps in every
scan of which the truth is known. Light of hidden objects taken for it scattered by 50 to 550 ps."""


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
    """None where the points cannot tell (fewer than nine, or on one line), and no drawing of the bench does."""
    response: ImpulseResponse
    bin_width_s: float
    off_the_drawing: bool = False
    """Whether the points alone tell no wall, and where the bench's drawing has it does not explain them."""

    @property
    def found(self) -> Flags:
        return np.isfinite(self.error_bins)

    @property
    def stray(self) -> Flags:
        """Points with a pulse that the fitted wall does not explain; none without a wall."""
        return self.found & ~self.wall.accepted if self.wall else np.zeros(len(self.error_bins), bool)

    @property
    def cut(self) -> Flags:
        """Points whose pulse comes where the record begins, and is not all in it."""
        return self.found & (np.nan_to_num(self.measured_bins, nan=np.inf) < -self.response.start_s / self.bin_width_s)

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

    @property
    def on_a_plane(self) -> bool:
        """Whether a plane wall explains the arrivals: what stands out is light that came straight from it."""
        if self.wall is None:
            return False
        typical = float(np.median(self.error_bins[self.wall.accepted]))
        return self.rms_bins <= max(0.5, PLANE_S / self.bin_width_s, 2 * typical)


@dataclass(frozen=True)
class Record:
    """What arrivals are looked for in."""

    recorded: npt.NDArray[np.generic]  # (N, T)
    x: Floats  # (N,)
    y: Floats
    time: TimeAxis
    lit: Flags
    background: Floats
    box: int
    """Bins that a pulse is first looked for with."""
    scanner_m: Floats | None = None
    """(3,); where the bench's drawing has the scanner, for points that do not tell; None where nobody says."""

    def wall(self, arrival: Floats, error: Floats, near: WallTiming | None = None) -> WallTiming | None:
        """By arrivals (N,) in bins and their errors; `near`: as it was found before."""
        width, x, y = self.time.bin_width_s, self.x, self.y
        timed = self.time.start_s + arrival * width, error * width
        free = fit_wall_timing(*timed, x, y, None if near is None or near.drawn else near)
        if self.scanner_m is None or (free is not None and free.placed):
            return free
        return fit_near_drawing(*timed, x, y, self.scanner_m) or free


def refined(
    record: Record, response: ImpulseResponse | None, first: Floats, gain: Floats, *, steps: bool = True
) -> TimeOffsets:
    """The arrivals around `first` (N,), where a pulse of `gain` (N,) was seen; with `steps`, bright ones far from the
    fitted plane are believed. Raises `NoDirectPeak`."""
    recorded, x, y, time = record.recorded, record.x, record.y, record.time
    lit, background, box, width = record.lit, record.background, record.box, record.time.bin_width_s
    bright = lit & (gain > DETECTION)
    if not bright.sum() >= max(1.0, FEWEST_SHARE * lit.sum()):
        raise _no_direct_peak(recorded, lit, bright, gain)
    arrival, error = first, np.where(bright, box / 3.5, np.inf)
    template, radius, wall = response, 3 * box, None
    for number in range(ROUNDS):
        wall = record.wall(arrival, error, wall)
        predicted = _predicted(wall, x, y, time)
        centre = _centre(arrival, error, wall, predicted, first, width)
        if response is None:
            trusted = np.isfinite(error) & (wall.accepted if wall else True)
            if not trusted.any():
                raise _no_direct_peak(recorded, lit, trusted, gain)
            template = _stacked_response(recorded, trusted, centre, background, width)
        assert template is not None
        previous = arrival
        arrival, error = match(recorded, background, centre, template, width, radius)
        error[~lit] = np.inf
        shift = np.abs(arrival - previous)[np.isfinite(error)]
        if number > 1 and len(shift) and np.quantile(shift, 0.9) < 0.03:
            break
        scatter = wall.rms_s / width if wall else 0.0
        least = max(SMALLEST_RADIUS_BINS, int(SMALLEST_RADIUS * template.fwhm_s() / width))
        radius = int(np.clip(np.ceil(6 * scatter), least, max(3 * box, least)))
    assert template is not None
    wall = record.wall(arrival, error, wall)
    predicted = _predicted(wall, x, y, time)
    direct = window_counts(recorded, np.where(np.isfinite(error), arrival, predicted), background, template, width)
    elsewhere = np.zeros(len(recorded), bool)
    if (
        steps and wall is not None
    ):  # as bright a pulse as the others', but far from the fitted plane: there the wall is not plane
        aside, aside_error = match(recorded, background, first, template, width, 3 * box)
        aside_counts = window_counts(recorded, aside, background, template, width)
        typical = np.median(direct[np.isfinite(error)]) if np.isfinite(error).any() else 0.0
        elsewhere = ~np.isfinite(error) & bright & np.isfinite(aside_error) & (aside_counts > max(0.5 * typical, 50.0))
        elsewhere &= (predicted > 0) & (predicted < time.bins)  # else the pulse was missed, and this is its tail
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
        bin_width_s=width,
    )


def _no_direct_peak(recorded: npt.NDArray[np.generic], lit: Flags, bright: Flags, gain: Floats) -> NoDirectPeak:
    points = int(lit.sum())
    seen = chosen(recorded, lit)
    if is_flat(seen):
        each = float(seen.sum(axis=1, dtype=np.float64).mean()) if points else 0.0
        return ShutterClosed(
            f"all {points} points hold {each:.2f} counts on average, evenly over time: no laser light reached the "
            "detector, from point 0 on. Was the shutter closed?"
        )
    best = int(np.argmax(gain))
    return NoDirectPeak(
        f"only {int(bright.sum())} of {points} points show a direct peak (point {best} stands out most, by "
        f"{gain[best]:.1f} in log-likelihood; {DETECTION:.0f} is needed). Check the laser, and whether the "
        "time window covers the wall."
    )


def _predicted(wall: WallTiming | None, x: Floats, y: Floats, time: TimeAxis) -> Floats:
    return np.full(len(x), np.nan) if wall is None else (wall.arrival_s(x, y) - time.start_s) / time.bin_width_s


def _centre(
    arrival: Floats, error: Floats, wall: WallTiming | None, predicted: Floats, first: Floats, width: float
) -> Floats:
    """Where to look next: at the wall's prediction for outliers and points without a pulse."""
    if wall is None:
        return np.where(np.isfinite(error), arrival, first)
    return np.where(wall.accepted, _weighed(arrival, error, wall, predicted, width), predicted)


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
    recorded: npt.NDArray[np.generic], trusted: Flags, centre: Floats, background: Floats, width: float
) -> ImpulseResponse:
    """The pulse of `trusted` points (N,) on a grid finer than the bins, down to 2 % of its maximum."""
    bins, points = recorded.shape[1], np.flatnonzero(trusted)
    before, after = min(bins, round(1e-9 / width) + 2), min(bins, round(3e-9 / width) + 4)
    total = stack(recorded, points, centre[points], (before, after), OVERSAMPLING)
    total -= background[points].sum() / OVERSAMPLING
    response = from_histogram(total, width / OVERSAMPLING).cropped(0.02)
    if response.fwhm_s() > max(WIDEST_PULSE_S, 4 * width):
        raise NoDirectPeak(
            f"what stands out at {len(points)} points is {response.fwhm_s() * 1e9:.1f} ns wide, too slow for a direct "
            "peak. Check laser and detector."
        )
    return response
