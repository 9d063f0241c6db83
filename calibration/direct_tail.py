"""Whether the tail of direct light is left in a scan whose direct light was cut off.

A detector's tail outlasts its peak by nanoseconds. Where the cut came too early, the first light that was kept is the
brightest for long, at every point alike, and fades; light of the scene rises again behind it.
"""

import numpy as np
import numpy.typing as npt

SMOOTH_S = 100e-12
FEWEST = 16
"""Stretches of that length in what was kept."""
LEAST = 0.2
"""Fall of the tail, as a share of how far the scene's light rises again (measured scans: 0.5 where it spoils a
picture, 0.1 and less where it does not)."""
ERRORS = 8.0
"""Standard errors of both."""
EVEN = 1.3
"""Between the brightest and the darkest of the darkest quarter of a record, where that is ambient light."""
FADED = 0.15
"""Share of the fall that is left where a cut is advised."""


def bins_of_tail(counts: npt.NDArray[np.floating], cut_bins: int, bin_width_s: float) -> int | None:
    """The number of bins to cut instead, or None where no tail is left. `counts` [T] are of all points together,
    `cut_bins` how many their owner cut; where that is 0, bins before the first count are taken for cut if every later
    bin holds ambient light.

    A surface right where the cut is looks the same; so does a wall parallel to a scanned one that fills the
    view, but before that nothing was cut."""
    lit = np.flatnonzero(counts > 0)
    if not len(lit):
        return None
    first = int(lit[0])
    kept = np.asarray(counts[first:], dtype=np.float64)
    joined = max(1, round(SMOOTH_S / bin_width_s))
    steps = len(kept) // joined
    if steps < FEWEST or first == 0 or (cut_bins and first > cut_bins + joined):
        return None
    light = kept[: steps * joined].reshape(steps, joined).sum(axis=1)
    darkest = np.sort(light)[: steps // 4]
    if not cut_bins and not 0 < darkest[-1] <= EVEN * darkest[0]:
        return None
    top = 1 + int(np.argmax(light[1:] - np.minimum.accumulate(light)[:-1]))
    lowest = int(np.argmin(light[: top + 1]))
    fall, rise = float(light[0] - light[lowest]), float(light[top] - light[lowest])
    error = float(np.sqrt(light[0] + light[lowest] + light[top]))
    if lowest < 2 or fall < max(LEAST * rise, ERRORS * error) or rise < ERRORS * error:
        return None
    faded = int(np.flatnonzero(light - light[lowest] <= FADED * fall)[0])
    return first + faded * joined
