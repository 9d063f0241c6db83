"""What a detector does after a click: how long it is blind, and how often it clicks again without a photon."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from nlos.calibration.errors import InvalidData

Floats = npt.NDArray[np.float64]
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
    told (a longer one leaves the same histogram as one shorter by the period). Weighted least squares for background
    and afterpulses under each dead time; its error is the spread of all dead times, weighed by their likelihood.
    Raises `InvalidData` where no dead time explains the histogram better than none does.
    """
    recorded, where = np.asarray(counts, dtype=np.float64), np.asarray(quiet, dtype=bool)
    model = _FullPeriod(recorded, sync_count, bin_width_s, where)
    period_s = len(recorded) * bin_width_s
    first_s = float(np.argmax(where)) * bin_width_s
    coarse = np.arange(first_s, period_s, max(0.5e-9, bin_width_s))
    trials = [(model.fit(dead, decay).chi2, dead, decay) for dead in coarse for decay in (10e-9, 30e-9, 90e-9)]
    without = model.fit(0.0, 30e-9).chi2
    least, dead, decay = min(trials)
    if not without - least > 25:
        raise InvalidData(
            f"no dead time between {first_s * 1e9:.1f} and {period_s * 1e9:.1f} ns explains the histogram. Record a "
            "longer or brighter one over the whole laser period."
        )
    trial_s = np.arange(first_s, period_s, bin_width_s)
    for _ in range(2):
        span = (float(np.log(max(decay / 4, 3 * bin_width_s))), float(np.log(min(decay * 4, period_s))))
        found = scipy.optimize.minimize_scalar(_chi2_of_decay, bounds=span, args=(model, dead), method="bounded")
        decay = float(np.exp(found.x))
        chi2s = np.array([model.fit(float(trial), decay).chi2 for trial in trial_s])
        dead = float(trial_s[np.argmin(chi2s)])
    weight = np.exp(-0.5 * (chi2s - chi2s.min()))
    error_s = float(np.sqrt((weight * (trial_s - dead) ** 2).sum() / weight.sum() + bin_width_s**2 / 12))
    fit = model.fit(dead, decay)
    step = 0.02
    slope = (
        model.fit(dead, decay * (1 + step)).chi2 + model.fit(dead, decay * (1 - step)).chi2 - 2 * fit.chi2
    ) / step**2
    drift = (model.fit(dead, decay * (1 + step)).probability - model.fit(dead, decay * (1 - step)).probability) / (
        2 * step
    )
    by_decay = abs(drift) * np.sqrt(2 / slope) if slope > 0 else 0.0
    return ClickAfterClick(dead, error_s, fit.probability, float(np.hypot(fit.error, by_decay)), decay)


def _chi2_of_decay(log_decay: float, model: "_FullPeriod", dead_s: float) -> float:
    return model.fit(dead_s, float(np.exp(log_decay))).chi2


@dataclass(frozen=True)
class _Fit:
    chi2: float
    probability: float
    error: float


class _FullPeriod:
    """The quiet bins of one period, expected from a dead time, an afterpulse probability and its decay."""

    def __init__(self, counts: Floats, sync_count: float, bin_width_s: float, quiet: npt.NDArray[np.bool_]) -> None:
        self._counts, self._pulses, self._width, self._quiet = counts, sync_count, bin_width_s, quiet
        self._running = np.concatenate([[0.0], np.cumsum(counts)])
        self._spectrum = np.fft.rfft(counts)
        self._weight = 1 / np.maximum(_smooth(counts[quiet], 64), 1.0)

    def fit(self, dead_s: float, decay_s: float) -> _Fit:
        """Background and afterpulse probability (not below 0) by linear least squares."""
        bins = len(self._counts)
        edges = np.arange(bins) - dead_s / self._width
        turns = np.floor(edges / bins)
        until = np.interp(edges - turns * bins, np.arange(bins + 1), self._running)
        live = 1 - (self._running[:-1] - until - turns * self._running[-1]) / self._pulses
        after = np.fft.irfft(self._spectrum * _kernel_spectrum(bins, self._width, decay_s, dead_s), bins)
        level, extra = live[self._quiet] * self._pulses, (live * after)[self._quiet]
        seen, weight = self._counts[self._quiet], self._weight
        ll, le, ee = (weight * level**2).sum(), (weight * level * extra).sum(), (weight * extra**2).sum()
        ls, es = (weight * level * seen).sum(), (weight * extra * seen).sum()
        determinant = max(ll * ee - le**2, 1e-9 * ll * ee)
        probability = max((ll * es - le * ls) / determinant, 0.0)
        background = (ls - probability * le) / ll
        chi2 = (weight * (seen - background * level - probability * extra) ** 2).sum()
        return _Fit(float(chi2), float(probability), float(np.sqrt(ll / determinant)))


def _kernel_spectrum(bins: int, bin_width_s: float, decay_s: float, dead_time_s: float) -> npt.NDArray[np.complex128]:
    """Spectrum of an exponential of area 1 that starts one dead time after the click, cyclic."""
    kernel = np.exp(-np.arange(bins) * bin_width_s / decay_s)
    delay = np.exp(-2j * np.pi * np.fft.rfftfreq(bins, bin_width_s) * dead_time_s)
    return np.asarray(np.fft.rfft(kernel / kernel.sum()) * delay)


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
