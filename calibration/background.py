"""Counts that no laser pulse made: dark counts, ambient light and late afterpulses."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from nlos.calibration.by_blocks import some_at_a_time, sums_from

Floats = npt.NDArray[np.float64]
FEWEST_BINS = 8
_BLOCKS, _NARROWEST, _WIDEST = 16, 4, 16
"""Stretches in which a reflection before the pulse is looked for; of so many bins."""
_UNEVEN = 1.25
"""Even light is as even as that: bins differ in width, afterpulses of the pulse before fade."""
_SHUT = 20.0
"""Counts that a stretch should have over all points, and has none, if it lies before a gate that opens."""
_ROUNDS = 4


@dataclass(frozen=True)
class Background:
    """Expected background counts in each bin of each point, and their standard error, both (N,)."""

    per_bin: Floats
    error: Floats
    stretch: tuple[int, int] | None = None
    """First bin and end of where it was measured at all points, if not before the pulse."""

    def at(self, points: npt.NDArray[np.bool_]) -> "Background":
        """Of some of the points, flags (N,)."""
        per_bin, error = (np.broadcast_to(each, points.shape)[points] for each in (self.per_bin, self.error))
        return Background(per_bin, error, self.stretch)


def before_pulse(counts: npt.ArrayLike, end_bins: npt.ArrayLike) -> Background:
    """From the bins before `end_bins` (N,), where no light of the present pulse can be but what a lens, a beam splitter
    or a pane threw back: bins that hold more than even light does are excluded (`quiet_before`).

    Each point's own mean, drawn towards the mean over all points as far as its counts do not tell them apart (gamma
    prior by moments). Points with fewer than 8 such bins get all points' mean; without any, the background is 0 and
    its error infinite.
    """
    recorded = np.asarray(counts)
    quiet = quiet_before(recorded, end_bins)
    length = quiet.sum(axis=1).astype(np.float64)
    length[length < FEWEST_BINS] = 0
    total = np.where(length > 0, sum_where(recorded, quiet), 0.0)
    return _drawn_together(total, length)


def in_stretch(counts: npt.ArrayLike, begin_bins: npt.ArrayLike, stretch: tuple[int, int]) -> Background:
    """The same from the bins of a stretch, of points (N,) in which the light behind direct light begins before it."""
    total = np.asarray(counts)[:, slice(*stretch)].sum(axis=1, dtype=np.float64)
    inside = np.asarray(begin_bins) <= stretch[0]  # not of NaN
    found = _drawn_together(np.where(inside, total, 0.0), np.where(inside, float(stretch[1] - stretch[0]), 0.0))
    return replace(found, stretch=stretch)


def _drawn_together(total: Floats, length: Floats) -> Background:
    """Of counts in so many bins, (N,): see `before_pulse`."""
    points = len(total)
    if not length.sum():
        return Background(np.zeros(points), np.full(points, np.inf))
    pooled = total.sum() / length.sum()
    used = length > 0
    spread = float(np.mean((total[used] - pooled * length[used]) ** 2 - pooled * length[used]))
    between = max(spread / float(np.mean(length[used] ** 2)), 0.0)  # variance of the rate from point to point
    if pooled <= 0 or between <= 0:
        return Background(np.full(points, pooled), np.full(points, np.sqrt(max(pooled, 0.0) / length.sum())))
    weight = pooled / between  # the prior is worth this many bins
    per_bin = (total + weight * pooled) / (length + weight)
    return Background(per_bin, np.sqrt(np.maximum(per_bin, 0) / (length + weight)))


def quiet_before(counts: npt.ArrayLike, end_bins: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Which bins before `end_bins` (N,) hold even light alone, (N, L): not those of stretches that hold a quarter and
    five standard errors more than the point's median one and than what is left of all points, nor the ones beside, nor
    those in which a gate is shut. What is bright in half of a point's stretches is no reflection, and stays."""
    recorded = np.asarray(counts)
    end = np.clip(np.floor(np.nan_to_num(np.asarray(end_bins, dtype=np.float64))), 0, recorded.shape[1]).astype(int)
    latest = int(end.max(initial=0))
    block = min(max(latest // _BLOCKS, _NARROWEST), _WIDEST)
    blocks = -(-latest // block)
    inside = np.clip(end[:, None] - np.arange(blocks) * block, 0, block)  # (N, blocks): bins of each
    held = np.zeros(inside.shape)
    for some in some_at_a_time(len(recorded)):
        part = np.where(np.arange(blocks * block) < end[some, None], _padded(recorded[some], blocks * block), 0)
        held[some] = part.reshape(len(part), blocks, block).sum(axis=2)
    expected = held.sum() / max(inside.sum(), 1) * inside.sum(axis=0)
    shut = (held.sum(axis=0) == 0) & (expected > _SHUT)
    inside[:, shut | np.append(False, shut[:-1]) | np.append(shut[1:], False)] = 0  # in which it opens, too
    rate = np.where(inside > 0, held / np.maximum(inside, 1), np.nan)
    own = np.zeros(len(end))
    some_left = inside.any(axis=1)
    own[some_left] = np.nanmedian(rate[some_left], axis=1)
    there = inside > 0
    kept = there
    for _ in range(_ROUNDS):
        if not kept.any():
            return np.arange(latest) < end[:, None]
        level = np.maximum(own, held[kept].sum() / inside[kept].sum())[:, None] * inside
        bright = (held > _UNEVEN * level + 5 * np.sqrt(np.maximum(level, 0)) + 5) & there
        bright[bright.sum(axis=1) > there.sum(axis=1) / 2] = False
        beside = bright.copy()
        for later in (1, 2):  # its tail
            beside[:, later:] |= bright[:, :-later]
        beside[:, :-1] |= bright[:, 1:]
        kept = there & ~beside
    quiet = np.zeros((len(end), latest), dtype=np.bool_)
    for some in some_at_a_time(len(end)):
        quiet[some] = np.repeat(kept[some], block, axis=1)[:, :latest] & (np.arange(latest) < end[some, None])
    return quiet


def sum_where(counts: npt.ArrayLike, kept: npt.NDArray[np.bool_]) -> Floats:
    """Of each point's counts (N, T) in the bins `kept` (N, L) of its first L, (N,)."""
    recorded = np.asarray(counts)
    return np.array([row[: len(of)][of].sum(dtype=np.float64) for row, of in zip(recorded, kept, strict=True)])


def _padded(recorded: npt.NDArray[np.generic], length: int) -> npt.NDArray[np.generic]:
    some = recorded[:, :length]
    return np.pad(some, ((0, 0), (0, length - some.shape[1])))


def dark_rate_per_bin(counts: npt.ArrayLike, exposure_s: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Counts per second in each bin and its standard error, both (T,), from a scan with the shutter closed.

    `counts` (N, T), `exposure_s` (N,). Bins differ (in width, or by what couples in) as far as their counts vary more
    than chance has it; what is chance is drawn to the mean of all bins.
    """
    total = np.asarray(counts).sum(axis=0, dtype=np.float64)
    seconds = float(np.sum(exposure_s))
    if not seconds > 0:
        raise ValueError("a dark rate needs some exposure")
    mean = float(total.mean())
    between = max(float(total.var()) - mean, 0.0)
    own = between / (between + mean) if mean > 0 else 0.0
    per_bin = own * total + (1 - own) * mean
    return per_bin / seconds, np.sqrt(own * np.maximum(per_bin, 1.0) + max(mean, 1.0) / len(total)) / seconds


def subtract(counts: npt.ArrayLike, per_bin: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Counts less the expected background, negative where chance has it so: clipping would add light. `per_bin` is
    (N,), or (N, T) or (T,)-shaped where it depends on the bin."""
    recorded = np.asarray(counts)
    expected = np.asarray(per_bin, dtype=np.float32)
    if expected.shape == recorded.shape[:1] and expected.shape != recorded.shape[1:]:
        expected = expected[:, None]
    return np.asarray(recorded - expected, dtype=np.float32)


def quiet_background(counts: npt.ArrayLike) -> Floats:
    """Counts per bin away from any light, shape (N,): the mean over those sixteenths of the record that are the
    quietest quarter on average over all points, drawn towards all points' mean where counts are few."""
    recorded = np.asarray(counts)
    points, bins = recorded.shape
    edges = np.linspace(0, bins, min(16, bins) + 1).astype(int)
    totals = sums_from(recorded, edges[:-1])  # (N, blocks)
    quiet = np.argsort(totals.mean(axis=0) / np.diff(edges))[: max(1, len(edges) // 4)]
    length = np.diff(edges)[quiet].sum()
    pooled = max(totals[:, quiet].sum() / (length * points), 1e-9)
    drawn = (totals[:, quiet].sum(axis=1) + 1) / (length + 1 / pooled)
    return np.asarray(np.maximum(drawn, 1e-3 * pooled))  # corrected counts may add up to less than 0


def is_flat(counts: npt.ArrayLike) -> bool:
    """Whether all points' counts together are as even in time as chance allows: no laser light in them."""
    total = np.asarray(counts).sum(axis=0, dtype=np.float64)
    edges = np.linspace(0, len(total), min(32, len(total)) + 1).astype(int)
    blocks, length = np.add.reduceat(total, edges[:-1]), np.diff(edges)
    expected = total.sum() * length / length.sum()
    freedom = len(length) - 1
    return bool(((blocks - expected) ** 2 / np.maximum(expected, 1e-9)).sum() < freedom + 6 * np.sqrt(2 * freedom) + 1)
