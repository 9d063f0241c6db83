"""In which bins a gated detector was open: elsewhere there is no background to subtract.

A gate that closes before the record ends, or in its middle, leaves bins that are exactly 0 at every point. In a scan
without ambient light such bins are dark, and the background is 0; with it they are blind, and say nothing of it.
"""

import numpy as np
import numpy.typing as npt

STRETCH = 8
"""Bins that are looked at together, and the fewest empty ones within a record that are no chance."""
FEWEST = 4
EMPTY = 0.25
"""Of the bins of the darkest stretches, at most: where fewer are empty, eight empty ones in a row are no chance."""
DARKEST = 0.25
"""Of all stretches: ambient light alone reaches as many at least."""
EVEN = 1.3
"""Between the brightest and the darkest of those, where it is ambient light."""
SHARP = 0.5
"""Of ambient light, at least, is there at once where a gate opens."""
MET = 0.7
"""Of the coincidences of independent light, at least. A surface's light comes to a point once, ambient light always."""


def open_bins(histograms: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_] | None:
    """The bins (T,) in which the detector was open, of histograms (T, N) of points in any unit; None where it was open
    all the time from the first count on, or where no ambient light shows that it was not."""
    profile = histograms.mean(axis=1, dtype=np.float64)
    lit = np.flatnonzero(profile)
    if len(lit) < FEWEST * STRETCH:
        return None
    opened = _without_long_gaps(profile != 0)
    if opened[lit[0] :].all():
        return None
    stretches = np.concatenate([_whole_stretches(first, end) for first, end in _runs(opened)])
    if len(stretches) < FEWEST:
        return None
    means = profile[stretches].mean(axis=1)
    darkest = np.argsort(means, kind="stable")[: max(FEWEST, round(DARKEST * len(means)))]
    level = float(np.median(means[darkest]))
    even = 0 < means[darkest[-1]] <= EVEN * means[darkest[0]]
    if not even or np.mean(profile[stretches[darkest]] == 0) > EMPTY or not _opens_at_once(profile, opened, level):
        return None
    return opened if _meets_everywhere(histograms[stretches[darkest]].sum(axis=1, dtype=np.float64)) else None


def _without_long_gaps(lit: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """True but before the first, after the last, and in gaps of `STRETCH` bins and more."""
    opened = np.ones(len(lit), bool)
    for first, end in _runs(~lit):
        opened[first:end] = first > 0 and end < len(lit) and end - first < STRETCH
    return opened


def _runs(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """First bin and the one after the last of each run, (R, 2)."""
    return np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))).reshape(-1, 2)


def _whole_stretches(first: int, end: int) -> npt.NDArray[np.intp]:
    """(S, STRETCH) bins, the first and the last of a run excluded: a gate may open within a bin."""
    count = max(end - first - 2, 0) // STRETCH
    return first + 1 + np.arange(count * STRETCH).reshape(count, STRETCH)


def _opens_at_once(profile: npt.NDArray[np.float64], opened: npt.NDArray[np.bool_], level: float) -> bool:
    """Whether light is as bright as `level` wherever a gate opens or closes within the record."""
    for first, end in _runs(opened):
        inside = profile[first + 1 : end - 1]
        ends = ((first > 0, inside[:STRETCH]), (end < len(profile), inside[-STRETCH:]))
        if any(at and not (part.size and part.mean() >= SHARP * level) for at, part in ends):
            return False
    return True


def _meets_everywhere(sums: npt.NDArray[np.float64]) -> bool:
    """Whether a point that has light in one stretch of (S, N) has it in the others, too, as often as by chance."""
    total = sums.sum(axis=0)
    met = float((total**2).sum() - (sums**2).sum())
    each = sums.sum(axis=1)
    chance = float(each.sum() ** 2 - (each**2).sum()) / sums.shape[1]
    return bool(met >= MET * chance > 0)
