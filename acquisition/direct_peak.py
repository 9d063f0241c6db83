"""The direct peak of a histogram: when it comes, how high it stands, how wide it is."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.drivers.tcspc.counter import HistogramAxis

_HALF_WINDOW_S = 0.5e-9
_PART_OF_HIGHEST = 0.3
_SMOOTH_S = 20e-12
_SIGMAS = 6.0
"""Above chance, of the highest of thousands of places."""


@dataclass(frozen=True)
class DirectPeak:
    """`time_s`: its maximum after the sync pulse; `fwhm_s` None where too few photons tell it."""

    time_s: float
    error_s: float
    fwhm_s: float | None
    counts: float
    """Above the background, within half a nanosecond on either side."""


def direct_peak(
    counts: npt.NDArray[np.integer] | npt.NDArray[np.floating], axis: HistogramAxis, cyclic: bool = False
) -> DirectPeak | None:
    """The first high peak of a histogram (T,), or None where nothing stands out of the background's chance: a hidden
    surface may return more light than the wall, but later.

    `cyclic`: the histogram is the laser's whole period, whose end continues at its start; the first peak is then the
    one after the longest quiet.
    """
    seen = np.asarray(counts, dtype=np.float64)
    half = max(1, round(_HALF_WINDOW_S / axis.bin_width_s))
    if len(seen) < 4 * half or not seen.any():
        return None
    wrapped = np.concatenate([seen[-half:], seen, seen[:half]] if cyclic else [np.zeros(half), seen, np.zeros(half)])
    sums = np.convolve(wrapped, np.ones(2 * half + 1), mode="valid")  # (T,)
    background = float(np.median(sums))
    run = _first_run(sums - background >= _PART_OF_HIGHEST * (sums.max() - background), cyclic)
    window = (
        (run + np.arange(2 * half + 1)) % len(sums) if cyclic else np.arange(run, min(run + 2 * half + 1, len(sums)))
    )
    place = int(window[np.argmax(sums[window])])
    above = float(sums[place]) - background
    if above < _SIGMAS * np.sqrt(max(background, 1.0)) + 10:
        return None
    rows = wrapped[place : place + 2 * half + 1] - background / (2 * half + 1)
    top = int(np.argmax(rows))
    shoulders = slice(max(top - 2, 0), top + 3)
    weight = np.maximum(rows[shoulders], 0.0)
    middle = float((weight * np.arange(shoulders.start, shoulders.start + len(weight))).sum() / max(weight.sum(), 1e-9))
    centre = place - half + middle
    fwhm = _smoothed_fwhm(rows, axis.bin_width_s) if rows[top] >= 20 else None
    wide_s = (fwhm or 2.0) * axis.bin_width_s
    time_s = axis.offset_s + (centre + 0.5) * axis.bin_width_s
    if cyclic:
        time_s %= len(seen) * axis.bin_width_s
    return DirectPeak(time_s, wide_s / 2.355 / max(above, 1.0) ** 0.5, fwhm and fwhm * axis.bin_width_s, above)


def _first_run(high: npt.NDArray[np.bool_], cyclic: bool) -> int:
    """Where the first run of high places begins; round a period, the one with the longest quiet before it."""
    places = np.flatnonzero(high)
    if not cyclic or len(places) == len(high):
        return int(places[0])
    quiet = np.diff(places, prepend=places[-1] - len(high))
    return int(places[np.argmax(quiet)])


def _smoothed_fwhm(rows: npt.NDArray[np.float64], bin_width_s: float) -> float | None:
    """In bins. Bins finer than a counter's own clock hold many and few by turns: as many are taken together as make
    20 ps, and what that adds to the width is taken off again."""
    together = max(1, round(_SMOOTH_S / bin_width_s)) // 2 * 2 + 1
    smooth = np.convolve(rows, np.ones(together) / together, mode="same")
    width = _fwhm(smooth, int(np.argmax(smooth)))
    return None if width is None else float(np.sqrt(max(width**2 - 5.545 * (together**2 - 1) / 12, 0.25)))


def _fwhm(rows: npt.NDArray[np.float64], top: int) -> float | None:
    """Full width at half the maximum, in bins, by straight lines between bins; None where a flank is not there."""
    half = rows[top] / 2
    left = next((k for k in range(top, 0, -1) if rows[k - 1] <= half), None)
    right = next((k for k in range(top, len(rows) - 1) if rows[k + 1] <= half), None)
    if left is None or right is None:
        return None
    rise = left - (rows[left] - half) / (rows[left] - rows[left - 1])
    fall = right + (rows[right] - half) / (rows[right] - rows[right + 1])
    return float(fall - rise)
