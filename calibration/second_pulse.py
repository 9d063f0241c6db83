"""A second pulse behind the direct one: a laser that pulses twice, or light thrown back between lens and detector. It
comes as late at every point, and whatever is hidden is seen once more behind itself. Told, and taken out
(`without_second_pulses.py`) where no surface would do the same."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.arrival_rounds import TimeOffsets
from nlos.calibration.impulse_response import ImpulseResponse
from nlos.calibration.told import warn
from nlos.calibration.wall_timing import FEWEST_POINTS

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.floating]
_WIDTHS = 4
"""So many full widths of the response to each side of a bin tell what is below a pulse there."""
_LEAST_BINS = 6
_PHASES = 16
"""Places in a bin at which a pulse is looked for ..."""
_ROUNDS = 4
"""... and how often it is moved to where its slope says."""
_SURE = 8.0
"""Standard errors from which on a pulse is believed."""
_FAINTEST = 0.002
"""Of the direct pulse."""
_LIKE = 0.1
"""Of its maximum, by which a pulse may differ from the direct one; the edge of a hidden plane differs by more."""
_EVERYWHERE = 0.5
"""Of the share on average, which the median point must show: hidden light comes to each at its own time ..."""
_ITSELF = 2.0
"""... and where that is so many standard errors of a single point, three of four points."""
_CURVED = 0.05
"""Of a small surface's later arrival at points farther from it, beyond three standard errors: then it is a surface."""
_LEAN = np.deg2rad(0.1)
"""A large plane that leans against the wall by no more, beyond three standard errors of no more each, comes as late at
every point ..."""
_AS_BRIGHT = 0.25
"""... and, unless it is far larger than the wall, differs by more in brightness from its middle to its corners."""


@dataclass(frozen=True)
class SecondPulse:
    """How late it is, and how bright as a share of the direct pulse, with that share's standard error."""

    lag_s: float
    share: float
    share_error: float
    even: bool
    """Whether it is as late and as bright at every point as no surface would be that somebody put up by hand."""
    response: ImpulseResponse
    """What it looks like, as the direct one."""
    bin_width_s: float

    def is_at(self, lag_s: float) -> bool:
        """Whether what comes so late is this one, or what is left of it."""
        return abs(self.lag_s - lag_s) < self.response.fwhm_s()


@dataclass(frozen=True)
class _Fit:
    """A pulse at one place, on a parabola: its brightness in all points together, and what finds it in windows."""

    at: int
    lag_s: float
    share: float
    share_error: float
    columns: Floats  # (window, 4): pulse, 1, t, t^2


def second_pulse(
    counts: Counts, variance: Counts, offsets: TimeOffsets, x_m: Floats, y_m: Floats
) -> SecondPulse | None:
    """The clearest pulse as sharp as the direct one that is equally late at every point; None without one. `counts` and
    `variance` (N, T) begin at the direct arrivals `offsets`, and the direct light is out of them; `x_m`, `y_m` (N,)."""
    lit = offsets.found & (offsets.direct_counts > 0)
    if lit.sum() < FEWEST_POINTS:  # at every point alike says nothing of a few
        return None
    direct = offsets.direct_counts[lit]
    total, chance = (each.sum(axis=0, dtype=np.float64, where=lit[:, None]) for each in (counts, variance))
    fit = _clearest(total, chance, float(direct.sum()), offsets)
    if fit is None:
        return None
    fit = _between_phases(fit, total, float(direct.sum()), offsets)
    window, width_s = slice(fit.at, fit.at + len(fit.columns)), offsets.bin_width_s
    windows = np.asarray(counts[lit, window], dtype=np.float64)
    take, expected = np.linalg.pinv(fit.columns)[0], fit.share * direct
    each, places_m = windows @ take, np.stack([x_m[lit], y_m[lit]])
    chance = variance[lit, window] @ take**2 + expected * (fit.columns[:, 0] @ take**2)
    least = 0.25 if np.median(expected / np.sqrt(chance)) > _ITSELF else 0.5
    if not np.quantile(each, least) > _EVERYWHERE * fit.share * np.median(direct):
        return None
    lags = _lags(windows, fit, expected, width_s, places_m)
    if lags is not None and abs(lags.curved) > max(_CURVED, 3 * lags.curved_error):
        return None
    even = lags is not None and lags.lean < _LEAN and _as_bright(each, expected, places_m)
    return SecondPulse(fit.lag_s, fit.share, fit.share_error, even, offsets.response, width_s)


def _clearest(total: Floats, chance: Floats, direct: float, offsets: TimeOffsets) -> _Fit | None:
    """Where the sum of all points (T,) shows a pulse that stands out most among those as sharp as the direct one."""
    response, width_s = offsets.response, offsets.bin_width_s
    half = max(_LEAST_BINS, int(np.ceil(_WIDTHS * response.fwhm_s() / width_s)))
    if len(total) <= 2 * half:
        return None
    seen = np.lib.stride_tricks.sliding_window_view(total, 2 * half + 1)
    noise = np.lib.stride_tricks.sliding_window_view(np.maximum(chance, 1.0), 2 * half + 1)
    place = np.arange(-half, half + 1) / half
    best, found = _SURE, None
    for phase in np.arange(_PHASES) / _PHASES:
        shape = response.in_bins((-half - phase) * width_s, 2 * half + 1, width_s)
        columns = np.stack([shape, np.ones_like(place), place, place**2], axis=1)
        take = np.linalg.pinv(columns)
        bright, error = seen @ take[0], np.sqrt(noise @ take[0] ** 2)
        off = np.abs(seen - seen @ take.T @ columns.T) - 4 * np.sqrt(noise)
        unlike = off.max(axis=1) > _LIKE * bright * shape.max()
        clear = np.where(unlike | (bright < _FAINTEST * direct), 0.0, bright / error)
        at = int(np.argmax(clear))
        if clear[at] > best:
            best, lag_s = float(clear[at]), float((at + half + phase) * width_s)
            found = _Fit(at, lag_s, float(bright[at] / direct), float(error[at] / direct), columns)
    return found


def _between_phases(fit: _Fit, total: Floats, direct: float, offsets: TimeOffsets) -> _Fit:
    """The same where its pulse explains the sum of all points (T,) best, by its slope."""
    response, width_s, bins = offsets.response, offsets.bin_width_s, len(fit.columns)
    seen, lag_s, step_s = total[fit.at : fit.at + bins], fit.lag_s, width_s / _PHASES
    for _ in range(_ROUNDS):
        first_s = fit.at * width_s - lag_s
        later, shape, sooner = response.in_bins([first_s - step_s, first_s, first_s + step_s], bins, width_s)
        columns = np.column_stack([shape, fit.columns[:, 1:], (later - sooner) * _PHASES / 2])
        part = np.linalg.pinv(columns) @ seen
        lag_s += float(np.clip(part[-1] / part[0], -1, 1)) * width_s
    return replace(fit, lag_s=lag_s, share=float(part[0] / direct), columns=columns[:, :-1])


@dataclass(frozen=True)
class _Lags:
    """How the delay of the pulse differs over the wall."""

    curved: float
    """1 for a small surface that is so far off as it is late, c t = 2 sqrt(d^2 + r^2)."""
    curved_error: float
    lean: float
    """Of a large plane that would come as late (rad), beyond three standard errors; infinite where those are larger."""


def _lags(windows: Floats, fit: _Fit, expected: Floats, width_s: float, places_m: Floats) -> _Lags | None:
    """Of points (2, N), each one's delay by the slope of the pulse; None where they lie so that they cannot tell."""
    x, y = places_m - places_m.mean(axis=1, keepdims=True)
    slope = np.gradient(fit.columns[:, 0]) / width_s
    later = -(windows @ np.linalg.pinv(np.column_stack([slope, fit.columns]))[0])  # (N,) counts times seconds
    curve_s = (x**2 + y**2) * 2 / (fit.lag_s * SPEED_OF_LIGHT_M_PER_S**2)
    found = _regressed(later, expected[:, None] * np.stack([np.ones_like(x), x, y, curve_s], axis=1))
    if found is None or not np.ptp(curve_s) > 0:
        return None
    part, error = found
    lean, unsure = (np.hypot(*each[1:3]) * SPEED_OF_LIGHT_M_PER_S / 2 for each in (part, error))
    beyond = max(float(lean - 3 * unsure), 0.0) if 3 * unsure < _LEAN else np.inf
    return _Lags(float(part[3]), float(error[3]), beyond)


def _as_bright(each: Floats, expected: Floats, places_m: Floats) -> bool:
    """Whether the brightness of points (N,) does not change, over what is expected, from the middle outwards."""
    x, y = places_m - places_m.mean(axis=1, keepdims=True)
    aside = (x**2 + y**2) / max(float((x**2 + y**2).max()), 1e-30)
    found = _regressed(each, expected[:, None] * np.stack([np.ones_like(x), x, y, aside], axis=1))
    if found is None:
        return False
    part, error = found
    return bool(abs(part[3]) < max(_AS_BRIGHT * part[0], 3 * error[3]))


def _regressed(values: Floats, columns: Floats) -> tuple[Floats, Floats] | None:
    """Parts of `columns` (N, K) in `values` (N,) and their standard errors; None where there are too few."""
    scale = np.linalg.norm(columns, axis=0)
    if len(values) <= columns.shape[1] or not (scale > 0).all():
        return None
    inverse = np.linalg.pinv(columns / scale)
    part = inverse @ values / scale
    spread = np.std(values - columns @ part, ddof=columns.shape[1])
    return part, spread * np.linalg.norm(inverse, axis=1) / scale


def doubt_second_pulse(found: SecondPulse | None) -> None:
    """Says where it is, what it does to a picture, and whether it is taken out."""
    if found is None:
        return
    behind_m = found.lag_s * SPEED_OF_LIGHT_M_PER_S / 2
    does = (
        "It is taken out, with all that it shows once more of what is hidden."
        if found.even
        else f"What is hidden is seen once more {behind_m:.2f} m behind itself, the pulse as a haze about there. If "
        "neither is so, it is a surface as far from every point."
    )
    warn(
        "a second pulse comes %.2f ns after the direct one at every point, as sharp and %.2g %% as bright: a laser "
        "that pulses twice, or light thrown back between lens and detector. %s",
        found.lag_s * 1e9, 100 * found.share, does,
    )  # fmt: skip
