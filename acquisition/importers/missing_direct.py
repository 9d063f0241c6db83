"""Whether a record lacks the light that comes straight from the wall: gated out, or never rendered."""

import numpy as np
import numpy.typing as npt

_NEAR_BINS = 3
_SHARE = 0.1


def direct_is_missing(counts: npt.NDArray[np.generic], offset_bins: npt.NDArray[np.float64]) -> bool:
    """Of counts (T, H, W) whose wall is reached by light at bins (H, W), by the file's own geometry: whether there is
    light after that time and none worth mentioning at it or before it, on average over the points."""
    bins, rows, cols = counts.shape
    first = np.floor(offset_bins).astype(np.int64)
    sums, places = np.zeros(2 * bins), np.zeros(2 * bins)
    for row, col in np.ndindex(rows, cols):
        start = bins - int(first[row, col])
        if 0 <= start <= bins:  # the wall's light would be within the record
            sums[start : start + bins] += counts[:, row, col]
            places[start : start + bins] += 1
    mean = sums / np.maximum(places, 1)
    upto, after = mean[: bins + _NEAR_BINS + 1], mean[bins + _NEAR_BINS + 1 :]
    return bool(places.any() and after.max() > 0 and upto.max() < _SHARE * after.max())


SAID = (
    "no direct light is recorded when light reaches the wall by the file's geometry: time 0 is taken from that (where "
    "it is recorded at another time: --raw)"
)
