"""Hidden light of the pulse before, which comes so late that it is recorded before the present one, and the detector's
afterpulses to that pulse: they are no ambient light, though they come where that is measured."""

import numpy as np
import numpy.typing as npt

from nlos.calibration.background import before_pulse
from nlos.calibration.by_blocks import sums_from
from nlos.calibration.told import warn

Floats = npt.NDArray[np.float64]
_STRETCHES = 16
"""Of the record, of which the darkest behind the pulse tells."""
_PARTS = 4
"""Of a stretch, which are as bright as each other unless a gate or the laser's period ends there: ..."""
_UNEVEN, _CHANCE = 0.3, 12.0
"""... standard deviation over mean, and the squared one over what chance makes of it, from which on they are not."""
_SHUT = 20.0
"""Counts that a stretch should have over all points, and has none, if it lies behind a gate."""
_CLOSED = 0.25
"""Of what there was is left, at most, where a gate that leaks closes within two parts."""
_BRIGHTER = 1.25
"""Even light is as even as that."""
_SURE = 5.0
"""Standard errors."""
_UNDONE = 0.5
"""Of what is missing may be due to what was undone."""


def dark_stretch(
    counts: npt.NDArray[np.generic], recorded: npt.NDArray[np.generic], end_bins: Floats, begin_bins: Floats
) -> tuple[int, int] | None:
    """First bin and end of the darkest stretch of `counts` (N, T) from `begin_bins` (N,) on over all points, where that
    is darker than before `end_bins` (N,), which is warned of; else None. Behind the laser's period, or a gate, nothing
    is told (`_open`), nor what is in the `recorded` counts (N, T) hardly, or twice as much: undoing a dead time that is
    not that well known makes it."""
    bins = counts.shape[1]
    edges = np.linspace(0, bins, max(min(_STRETCHES, bins // _PARTS), 1) * _PARTS + 1).astype(int)
    background = before_pulse(counts, end_bins)
    behind = np.isfinite(begin_bins) & np.isfinite(background.error)
    whole = np.repeat(behind & (np.nan_to_num(begin_bins)[:, None] <= edges[:-1:_PARTS]).T, _PARTS, axis=0)
    held = sums_from(counts, edges[:-1]).T  # (parts, N), as `whole`
    due = (whole * np.diff(edges)[:, None] * background.per_bin).sum(axis=1)  # (parts,)
    there = np.where(whole, held, 0.0).sum(axis=1)
    tells = (whole[::_PARTS].sum(axis=1) > np.isfinite(begin_bins).sum() / 4) & _open(there, due)
    expected, seen = (each.reshape(-1, _PARTS).sum(axis=1) for each in (due, there))  # (stretches,)
    if not tells.any():
        return None
    darkest = int(np.argmin(np.where(tells, seen / np.maximum(expected, 1e-30), np.inf)))
    share, fewer = float(seen[darkest] / expected[darkest]), float(expected[darkest] - seen[darkest])
    if fewer < _SURE * np.sqrt(expected[darkest]) or share * _BRIGHTER > 1:
        return None
    stretch = int(edges[darkest * _PARTS]), int(edges[(darkest + 1) * _PARTS])
    if recorded is not counts:
        some = whole[darkest * _PARTS]
        per_bin = before_pulse(recorded[some], end_bins[some]).per_bin.sum()
        in_recorded = per_bin * (stretch[1] - stretch[0]) - recorded[some, slice(*stretch)].sum(dtype=np.float64)
        if abs(fewer - in_recorded) > _UNDONE * fewer:
            return None
    warn(
        "before the direct light it is %.2g times as bright as in the darkest stretch behind it, which is taken for "
        "ambient light instead. Light that comes so late that the next pulse overtakes it does that (a slower laser "
        "shows where from), as do late afterpulses (a record as long as the laser's period tells how many), and a "
        "detector that is still blind behind a bright pulse.",
        1 / share,
    )
    return stretch


def _open(seen: Floats, expected: Floats) -> npt.NDArray[np.bool_]:
    """Of stretches (S,), by what their parts (S * 4,) hold and even light would: in which the detector was open all the
    time. In those beside a shut one it may have closed."""
    parts, due = seen.reshape(-1, _PARTS), expected.reshape(-1, _PARTS).sum(axis=1)
    mean = parts.mean(axis=1)
    apart = ((parts - mean[:, None]) ** 2).sum(axis=1)
    uneven = (apart > _UNEVEN**2 * _PARTS * mean**2) & (apart > _CHANCE * mean)
    shut = (parts.sum(axis=1) == 0) & (due > _SHUT)
    beside = np.append(False, shut[:-1]) | np.append(shut[1:], False)
    closed = np.zeros(len(parts), dtype=bool)
    closed[_closes(seen, expected) // _PARTS :] = True
    return np.asarray((mean > 0) & (due > 0) & ~(uneven | shut | beside | closed))


def _closes(seen: Floats, expected: Floats) -> int:
    """The part of (P,) from which on not a quarter is left of the brightness of the four before, which are even: hidden
    light does not end so at once. P where there is none."""
    for last in range(_PARTS - 1, len(seen) - 2):
        before, later = slice(last + 1 - _PARTS, last + 1), slice(last + 2, None)
        mean = seen[before].mean()
        apart = ((seen[before] - mean) ** 2).sum()
        if apart > max((_UNEVEN / 2) ** 2 * _PARTS * mean**2, _CHANCE * mean):
            continue
        if seen[later].sum() * expected[before].sum() < _CLOSED * seen[before].sum() * expected[later].sum():
            return last + 1
    return len(seen)
