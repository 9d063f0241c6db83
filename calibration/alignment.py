"""Shifts every histogram so that its direct arrival falls on time zero; no count is invented, lost or wrapped."""

import numpy as np
import numpy.typing as npt

from nlos.calibration.background import Background

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.float32]
_SURE = 5.0
"""Standard deviations."""


def align(counts: npt.ArrayLike, offset_bins: npt.ArrayLike, bins: int) -> Counts:
    """Histograms with bin 0 starting `offset_bins` into the record, shape (N, bins).

    Each bin's counts are taken as spread evenly over the bin and are divided between the two new bins that it
    overlaps, so a fractional shift conserves them in the mean. What lies outside of the record is 0, never
    the other end of it. `counts` (N, T), `offset_bins` (N,), fractional, of either sign.
    """
    recorded = np.asarray(counts)
    whole, part = _split(offset_bins, len(recorded))
    first = _window(recorded, whole, bins + 1)
    weight = part.astype(np.float32)[:, None]
    return first[:, :-1] * (1 - weight) + first[:, 1:] * weight


def align_variance(variance: npt.ArrayLike, offset_bins: npt.ArrayLike, bins: int) -> Counts:
    """Variance of `align`'s result for independent bins of the given variance (for raw counts: the counts)."""
    recorded = np.asarray(variance)
    whole, part = _split(offset_bins, len(recorded))
    first = _window(recorded, whole, bins + 1)
    weight = part.astype(np.float32)[:, None]
    return first[:, :-1] * (1 - weight) ** 2 + first[:, 1:] * weight**2


def light_beyond(counts: npt.ArrayLike, offset_bins: npt.ArrayLike, bins: int, background: Background) -> float:
    """Counts above the background after the last of the bins that `align` keeps; 0 where chance may have made them."""
    recorded = np.asarray(counts)
    begin = np.clip(np.ceil(np.asarray(offset_bins) + bins), 0, recorded.shape[1]).astype(np.int64)
    begin[~np.isfinite(background.error)] = recorded.shape[1]
    length = recorded.shape[1] - begin
    late = sum(float(row[at:].sum(dtype=np.float64)) for row, at in zip(recorded, begin, strict=True))
    error = np.where(length > 0, background.error, 0.0)
    above = late - float(background.per_bin @ length)
    return above if above > _SURE * (np.sqrt(max(late, 0.0)) + float(error @ length)) else 0.0


def recorded_bins(offset_bins: npt.ArrayLike, record_bins: int, bins: int) -> npt.NDArray[np.bool_]:
    """Where the aligned result rests wholly on recorded bins, shape (N, bins)."""
    offsets = np.asarray(offset_bins, dtype=np.float64)[:, None]
    start = offsets + np.arange(bins)
    return np.asarray((start >= 0) & (start + 1 <= record_bins))


def _split(offset_bins: npt.ArrayLike, points: int) -> tuple[npt.NDArray[np.int64], Floats]:
    offsets = np.asarray(offset_bins, dtype=np.float64)
    if offsets.shape != (points,):
        raise ValueError(f"offset_bins has shape {offsets.shape}, but there are {points} histograms")
    whole = np.floor(offsets)
    return whole.astype(np.int64), offsets - whole


def _window(recorded: npt.NDArray[np.generic], first: npt.NDArray[np.int64], length: int) -> Counts:
    """`length` bins from `first` on in each row, 0 outside of the record."""
    result = np.zeros((len(recorded), length), dtype=np.float32)
    record = recorded.shape[1]
    for row, start in enumerate(first):
        low, high = max(int(start), 0), min(int(start) + length, record)
        if high > low:
            result[row, low - start : high - start] = recorded[row, low:high]
    return result
