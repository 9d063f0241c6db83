"""A second pulse behind the direct one: a laser that pulses twice, or light thrown back between lens and detector. It
comes as late at every point, and whatever is hidden is seen once more behind itself."""

import logging
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.arrival_rounds import TimeOffsets

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.floating]
log = logging.getLogger(__name__)
_WIDTHS = 4
"""So many full widths of the response to each side of a bin tell what is below a pulse there."""
_LEAST_BINS = 6
_PHASES = 16
"""Places in a bin at which a pulse is looked for."""
_SURE = 8.0
"""Standard errors from which on a pulse is believed."""
_FAINTEST = 0.002
"""Of the direct pulse."""
_LIKE = 0.1
"""Of its maximum, by which a pulse may differ from the direct one; the edge of a hidden plane differs by more."""
_EVERYWHERE = 0.5
"""Of the share on average, which the median point must show: hidden light comes to each at its own time."""
_CURVED = 0.05
"""Of a small surface's later arrival at points farther from it, beyond three standard errors: then it is a surface."""


@dataclass(frozen=True)
class SecondPulse:
    """How late it is, and how bright as a share of the direct pulse, with that share's standard error."""

    lag_s: float
    share: float
    share_error: float


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
    if not lit.any():
        return None
    seen, direct = np.asarray(counts[lit], dtype=np.float64), offsets.direct_counts[lit]
    fit = _clearest(seen.sum(axis=0), variance[lit].sum(axis=0, dtype=np.float64), float(direct.sum()), offsets)
    if fit is None:
        return None
    windows = seen[:, fit.at : fit.at + len(fit.columns)]
    each = windows @ np.linalg.pinv(fit.columns)[0]
    if not np.median(each) > _EVERYWHERE * fit.share * np.median(direct):
        return None
    if _is_surface(windows, fit, fit.share * direct, offsets.bin_width_s, np.stack([x_m[lit], y_m[lit]])):
        return None
    return SecondPulse(fit.lag_s, fit.share, fit.share_error)


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
        off = np.abs(seen - seen @ take.T @ columns.T).max(axis=1)
        unlike = off > _LIKE * bright * shape.max() + 4 * np.sqrt(noise.max(axis=1))
        clear = np.where(unlike | (bright < _FAINTEST * direct), 0.0, bright / error)
        at = int(np.argmax(clear))
        if clear[at] > best:
            best, lag_s = float(clear[at]), float((at + half + phase) * width_s)
            found = _Fit(at, lag_s, float(bright[at] / direct), float(error[at] / direct), columns)
    return found


def _is_surface(windows: Floats, fit: _Fit, expected: Floats, width_s: float, places_m: Floats) -> bool:
    """Whether the light comes later to points (2, N) farther aside, as that of a small surface does that is so far off
    as it is late, c t = 2 sqrt(d^2 + r^2), or earlier: each point's delay is told by the slope of the pulse."""
    x, y = places_m - places_m.mean(axis=1, keepdims=True)
    slope = np.gradient(fit.columns[:, 0]) / width_s
    later = -(windows @ np.linalg.pinv(np.column_stack([slope, fit.columns]))[0])  # (N,) counts times seconds
    curve_s = (x**2 + y**2) * 2 / (fit.lag_s * SPEED_OF_LIGHT_M_PER_S**2)
    columns = expected[:, None] * np.stack([np.ones_like(x), x, y, curve_s], axis=1)
    if len(x) <= columns.shape[1] or not np.ptp(curve_s) > 0:
        return False
    scale = np.linalg.norm(columns, axis=0)
    inverse = np.linalg.pinv(columns / scale)
    part = inverse @ later / scale
    spread = np.std(later - columns @ part, ddof=columns.shape[1])
    error = spread * np.linalg.norm(inverse[3]) / scale[3]
    return bool(abs(part[3]) > max(_CURVED, 3 * error))


def doubt_second_pulse(found: SecondPulse | None) -> None:
    """Says where it is, and what it does to a picture."""
    if found is None:
        return
    log.warning(
        "a second pulse comes %.2f ns after the direct one at every point, as sharp and %.2g %% as bright: a laser "
        "that pulses twice, or light thrown back between lens and detector. What is hidden is seen once more %.2f m "
        "behind itself, the pulse as a haze about there. If neither is so, it is a surface as far from every point.",
        found.lag_s * 1e9, 100 * found.share, found.lag_s * SPEED_OF_LIGHT_M_PER_S / 2,
    )  # fmt: skip
