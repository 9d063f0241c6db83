"""What a detector does after a click: how long it is blind, and how often it clicks again without a photon."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from nlos.calibration.dead_time import blind_pulses
from nlos.calibration.errors import InvalidData

Floats = npt.NDArray[np.float64]
DECAYS_S = (10e-9, 30e-9, 90e-9)
"""From which the search for afterpulses' decay begins."""
STOPPED = 1 / 3
"""Afterpulses that stop others are not in the model: of a probability of 0.15, at a photon a pulse, 0.008 is missed."""
_POINTS = 64
"""So many at a time: what is kept of each is some twenty histograms."""


@dataclass(frozen=True)
class ClickAfterClick:
    """Dead time and afterpulsing with standard errors. Afterpulses follow the dead time, falling as exp(-t / decay)."""

    dead_time_s: float
    dead_time_error_s: float
    afterpulse_probability: float
    afterpulse_error: float
    decay_s: float


def from_full_period(
    counts: npt.ArrayLike, sync_count: float, bin_width_s: float, quiet: npt.ArrayLike
) -> ClickAfterClick:
    """From one histogram over the laser's whole period, `counts` (T,) with the pulse at its start: until one dead time
    after the pulse fewer clicks of the background are seen, afterwards more, by afterpulses.

    `quiet` (T,) marks the bins that hold constant background only; dead times from its first bin up to the period are
    told (a longer one leaves the same histogram as one shorter by the period). Weighted least squares for background,
    afterpulses, their decay and the dead time together, whose joint errors are told, wider where dead times elsewhere
    explain the histogram nearly as well. Raises `InvalidData` where no dead time explains it better than none does.
    """
    recorded, where = np.asarray(counts, dtype=np.float64), np.asarray(quiet, dtype=bool)
    model = _FullPeriod(recorded, sync_count, bin_width_s, where)
    period_s, first_s = len(recorded) * bin_width_s, float(np.argmax(where)) * bin_width_s
    step_s = max(0.5e-9, bin_width_s)
    coarse = np.arange(first_s + step_s, period_s - step_s, step_s)
    trials = np.array([model.solve(dead, DECAYS_S[1])[0] for dead in coarse])
    without = float(model.solve(0.0, DECAYS_S[1])[0])
    if not (trials.size and without - trials.min() > 25):
        raise InvalidData(
            f"no dead time between {first_s * 1e9:.1f} and {period_s * 1e9:.1f} ns explains the histogram. Record a "
            "longer or brighter one over the whole laser period."
        )
    near_s = float(coarse[np.argmin(trials)])
    about_s = DECAYS_S[int(np.argmin([model.solve(near_s, decay)[0] for decay in DECAYS_S]))]
    low, high = np.log(3 * bin_width_s), np.log(period_s)

    def residuals(p: Floats) -> Floats:
        return model.residuals(float(p[0]) * bin_width_s, float(np.exp(p[1])))

    fit = scipy.optimize.least_squares(
        residuals,
        [near_s / bin_width_s, np.clip(np.log(about_s), low + 1e-3, high - 1e-3)],
        bounds=([(near_s - 2 * step_s) / bin_width_s, low], [(near_s + 2 * step_s) / bin_width_s, high]),
        x_scale=[1.0, 0.3],
        diff_step=[0.25 * bin_width_s / near_s, 0.01],
    )
    dead_s, decay_s = float(fit.x[0] * bin_width_s), float(np.exp(fit.x[1]))
    chi2, _, probability = model.solve(dead_s, decay_s)
    dead_error_s, error = model.errors(dead_s, decay_s)
    mass = np.exp(-0.5 * np.maximum(trials - chi2, 0)) * step_s / (np.sqrt(2 * np.pi) * dead_error_s)
    mass[np.abs(coarse - dead_s) < 3 * dead_error_s + step_s] = 0
    elsewhere_s2 = float((mass * (coarse - dead_s) ** 2).sum() / (1 + mass.sum()))
    return ClickAfterClick(dead_s, float(np.hypot(dead_error_s, np.sqrt(elsewhere_s2))), probability, error, decay_s)


class _FullPeriod:
    """The quiet bins of one period, expected from a dead time, an afterpulse probability and its decay."""

    def __init__(self, counts: Floats, sync_count: float, bin_width_s: float, quiet: npt.NDArray[np.bool_]) -> None:
        self._counts, self._pulses, self._width, self._quiet = counts, sync_count, bin_width_s, quiet
        level = _smooth(counts[quiet], 64)
        self._error: Floats = np.sqrt(np.maximum(level, 1.0))
        self._clicks = counts.copy()  # what afterpulses are of: no bin's own chance explains the same bin
        self._clicks[quiet] = level

    def solve(self, dead_s: float, decay_s: float) -> tuple[float, float, float]:
        """Chi squared, background per pulse and bin, and afterpulse probability (0 to 1)."""
        return self._solved(*self._columns(dead_s, decay_s))

    def _solved(self, level: Floats, extra: Floats) -> tuple[float, float, float]:
        """`solve` of the columns."""
        seen = self._counts[self._quiet] / self._error
        ll, le, ee = float(level @ level), float(level @ extra), float(extra @ extra)
        ls, es = float(level @ seen), float(extra @ seen)
        determinant = max(ll * ee - le**2, 1e-9 * ll * ee, 1e-300)
        probability = float(np.clip((ll * es - le * ls) / determinant, 0.0, 1.0))
        background = float((ls - probability * le) / max(ll, 1e-300))
        off = seen - background * level - probability * extra
        return float(off @ off), background, probability

    def residuals(self, dead_s: float, decay_s: float) -> Floats:
        """Over their standard errors, (quiet bins,)."""
        level, extra = self._columns(dead_s, decay_s)
        _, background, probability = self._solved(level, extra)
        return np.asarray(self._counts[self._quiet] / self._error - background * level - probability * extra)

    def errors(self, dead_s: float, decay_s: float) -> tuple[float, float]:
        """Standard errors of dead time (s) and afterpulse probability, whatever background and decay are."""
        level, extra = self._columns(dead_s, decay_s)
        chi2, background, probability = self._solved(level, extra)

        def expected(dead: float) -> Floats:
            each = self._columns(dead, decay_s)
            return np.asarray(background * each[0] + probability * each[1])

        by_dead = (expected(dead_s + self._width) - expected(dead_s - self._width)) / (2 * self._width)
        slower, faster = (self._columns(dead_s, decay_s * factor)[1] for factor in (1.05, 1 / 1.05))
        columns = np.stack([by_dead, extra, level, slower - faster], axis=1)
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        covariance = np.linalg.pinv((columns / scale).T @ (columns / scale))
        excess = max(chi2 / max(len(level) - 4, 1), 1.0)
        error = np.sqrt(np.maximum(covariance.diagonal() * excess, 0)) / scale
        return float(np.hypot(error[0], self._width / 12)), float(np.hypot(error[1], STOPPED * probability**2))

    def _columns(self, dead_s: float, decay_s: float) -> tuple[Floats, Floats]:
        """What one click per pulse and bin of background, and a probability of 1, make of the quiet bins."""
        clicks, width = self._clicks[None], self._width
        blind = blind_pulses(clicks, clicks.sum(), width, clicks.size * width, dead_s, self._pulses)
        live = np.maximum(1 - blind / self._pulses, 1e-6)
        seen = -np.log1p(-np.minimum(clicks / (self._pulses * live), 1 - 1e-9))
        extra = live * _afterpulses(seen, clicks / self._pulses, live, ClickAfterClick(dead_s, 0, 1, 0, decay_s), width)
        weight = self._pulses / self._error
        return live[0, self._quiet] * weight, extra[0, self._quiet] * weight


def _smooth(values: Floats, length: int) -> Floats:
    padded = np.pad(values, length // 2, mode="edge")
    running = np.concatenate([[0.0], np.cumsum(padded)])
    return np.asarray((running[length:] - running[:-length])[: len(values)] / length)


def subtract_afterpulses(
    photons: npt.ArrayLike, clicks: npt.ArrayLike, live: npt.ArrayLike, found: ClickAfterClick, bin_width_s: float
) -> Floats:
    """`photons` (N, T) per laser pulse, dead time already undone, less the afterpulses expected of all `clicks` (N, T)
    per pulse of a detector that is `live` (N, T), as a share of all pulses; all three over the laser's whole period.

    A carrier that comes free within a further dead time of becoming live again was stopped only by a photon in between;
    later ones found the detector live as often as photons did. It is not so blind to afterpulses of bright light as to
    other photons: the click itself says when it was live. Exact but for afterpulses that stop others.
    """
    seen, recorded, alive = (np.asarray(each, dtype=np.float64) for each in (photons, clicks, live))
    cleaned = np.empty_like(seen)
    for first in range(0, len(seen), _POINTS):
        some = slice(first, first + _POINTS)
        cleaned[some] = seen[some] - _afterpulses(seen[some], recorded[some], alive[some], found, bin_width_s)
    return cleaned


def _afterpulses(seen: Floats, clicks: Floats, live: Floats, found: ClickAfterClick, bin_width_s: float) -> Floats:
    """Afterpulses per pulse and share of it that the detector is live, (N, T)."""
    bins, dead, decay = seen.shape[1], found.dead_time_s / bin_width_s, found.decay_s / bin_width_s
    due = _earlier(clicks, dead + 0.5)  # a click is anywhere in its bin
    left = float(np.exp(-dead / decay))
    soon, kept, back = due, np.exp(-1 / decay - seen), 1
    while kept.max() > 1e-6:  # a step of the recursion looks twice as far back as the one before
        soon = soon + kept * np.roll(soon, back, axis=1)
        kept, back = kept * np.roll(kept, back, axis=1), 2 * back
    turns, rest = divmod(round(dead), bins)
    until = np.pad(np.cumsum(np.hstack([seen, seen]), axis=1), ((0, 0), (1, 0)))
    between = until[:, bins + 1 :] - until[:, bins + 1 - rest : 2 * bins + 1 - rest] + turns * until[:, bins, None]
    soon = soon - left * np.exp(-between) * np.roll(soon, round(dead), axis=1)
    late = left * _exponential(_earlier(due, dead), decay)
    return np.asarray(-np.expm1(-1 / decay) * found.afterpulse_probability * (soon / live + late))


def _earlier(values: Floats, by: float) -> Floats:
    """Rows (N, T) as they are `by` bins earlier, cyclic, linear between bins."""
    whole = int(np.floor(by))
    near, far = np.roll(values, whole, axis=1), np.roll(values, whole + 1, axis=1)
    return near + (by - whole) * (far - near)


def _exponential(values: Floats, decay: float) -> Floats:
    """Rows (N, T) after which exp(-bins / decay) of each bin is left, cyclic."""
    bins = values.shape[1]
    kernel = np.exp(-np.arange(bins) / decay) / -np.expm1(-bins / decay)
    return np.asarray(np.fft.irfft(np.fft.rfft(values, axis=1) * np.fft.rfft(kernel), bins, axis=1))
