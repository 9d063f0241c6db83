"""Counts as files hold them, made plain: axes of length 1 dropped, points that nobody measured empty."""

from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.importers.imported import ALL_NAN

Array = npt.NDArray[Any]


def without_single_axes(counts: Array) -> Array:
    """Counts of more than three dimensions without outer and inner axes of length 1: a frame, a colour."""
    while counts.ndim > 3 and 1 in (counts.shape[0], counts.shape[-1]):
        counts = counts[0] if counts.shape[0] == 1 else counts[..., 0]
    return counts


def without_missing(
    counts: Array, exposure_s: npt.NDArray[np.float64], notes: list[str]
) -> tuple[Array, npt.NDArray[np.float64]]:
    """Counts (..., T) and exposures (...) where points of which nothing is a number are not measured: exposure 0. Where
    that is 0, nothing is counted, whatever stands there. Other points that are no counts are refused later."""
    if counts.dtype.kind == "f" and (unsaid := np.isnan(counts).all(axis=-1) & (exposure_s > 0)).any():
        notes.append(f"{int(unsaid.sum())} {ALL_NAN}: taken for not measured")
        exposure_s = np.where(unsaid, 0.0, exposure_s)
    unmeasured = exposure_s == 0
    bad = unmeasured.any() and not (np.isfinite(held := counts[unmeasured]) & (held >= 0)).all()
    return (np.where(unmeasured[..., None], 0, counts) if bad else counts), exposure_s
