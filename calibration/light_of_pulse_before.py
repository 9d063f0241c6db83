"""Hidden light of the pulse before, which comes so late that it is recorded before the present one: it is no ambient
light, though it comes where that is measured."""

import logging
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from nlos.calibration.background import Background

Floats = npt.NDArray[np.float64]
log = logging.getLogger(__name__)
_STRETCHES = 16
"""Of the record, of which the darkest behind the pulse tells."""
_BRIGHTER = 1.25
"""Even light is as even as that."""
_SURE = 5.0
"""Standard errors."""


def without_light_of_pulse_before(
    background: Background, counts: npt.NDArray[np.generic], begin_bins: Floats
) -> Background:
    """The background of points (N,), no brighter than the darkest stretch of `counts` (N, T) from `begin_bins` (N,) on,
    over all points; warns where it was. Stretches that hold nothing are a gate's, and tell nothing."""
    points, bins = counts.shape
    behind = np.isfinite(begin_bins) & np.isfinite(background.error)
    edges = np.linspace(0, bins, min(_STRETCHES, bins) + 1).astype(int)
    whole = behind & (np.nan_to_num(begin_bins)[:, None] <= edges[:-1]).T  # (stretches, N)
    held = np.add.reduceat(counts, edges[:-1], axis=1, dtype=np.float64).T
    expected = (whole * np.diff(edges)[:, None] * background.per_bin).sum(axis=1)  # (stretches,)
    seen = np.where(whole, held, 0.0).sum(axis=1)
    tells = (whole.sum(axis=1) > points / 4) & (seen > 0) & (expected > 0)
    if not tells.any():
        return background
    darkest = int(np.argmin(np.where(tells, seen / np.maximum(expected, 1e-30), np.inf)))
    share = float(seen[darkest] / expected[darkest])
    if expected[darkest] - seen[darkest] < _SURE * np.sqrt(expected[darkest]) or share * _BRIGHTER > 1:
        return background
    log.warning(
        "before the direct light it is %.2g times as bright as in the darkest stretch behind it, which is taken for "
        "ambient light instead. Light that comes so late that the next pulse overtakes it does that (a slower laser "
        "shows where from), and a detector that is still blind behind a bright pulse.",
        1 / share,
    )
    return replace(background, per_bin=background.per_bin * share)
