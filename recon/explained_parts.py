"""A scan in two parts with independent noise: one to reconstruct from, one to judge the picture by."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import Transient
from nlos.acquisition.wall import WallGrid

KEPT = 0.75
"""The share of the light that the picture is made from; the rest judges it."""
FEWEST_POINTS = 24  # a side, below which nothing is added up
SEED = 20180305
BITS, MOST = np.uint64(63), 2**64 - 1


@dataclass(frozen=True)
class Parts:
    """Two scans of the same scene, as if they had lasted `KEPT` and 1 - `KEPT` of the time."""

    seen: Transient
    judging: Transient
    unit: float
    """What one photon counts: the variance of a count over its mean."""


def coarser(transient: Transient) -> Transient:
    """Wall points added up 2 x 2 where there are many: the check costs a fraction of the picture. An odd row or column
    gets an unmeasured neighbour."""
    wall = transient.wall
    if min(wall.rows, wall.cols) < FEWEST_POINTS:
        return transient
    missing = ((0, wall.rows % 2), (0, wall.cols % 2))
    counts, exposure_s = transient.counts, transient.exposure_s
    if wall.rows % 2 or wall.cols % 2:
        counts, exposure_s = np.pad(counts, ((0, 0), *missing)), np.pad(exposure_s, missing)
    rows, cols = exposure_s.shape
    grid = WallGrid(wall.width_m * cols / wall.cols, wall.height_m * rows / wall.rows, rows // 2, cols // 2)
    added = counts[:, ::2] + counts[:, 1::2]
    exposure_s = exposure_s[::2] + exposure_s[1::2]
    return replace(
        transient,
        counts=np.ascontiguousarray(added[..., ::2] + added[..., 1::2]),
        exposure_s=exposure_s[:, ::2] + exposure_s[:, 1::2],
        wall=grid,
    )


def split(transient: Transient, unit: float, seed: int = SEED) -> Parts:
    """`transient` thinned: photon by photon where it holds whole counts (`unit` 1), which leaves two independent
    Poisson scans; else by Gaussian noise of the variance found in it, which does the same for its noise."""
    rng = np.random.default_rng(seed)
    counts = transient.counts
    if unit == 1.0 and are_counts(counts):
        seen = counts - quarter_of(counts.astype(np.uint64), rng).astype(counts.dtype)
    else:
        spread = np.sqrt(np.maximum(KEPT * (1 - KEPT) * unit * counts, 0, dtype=np.float32))
        seen = np.float32(KEPT) * counts + spread * rng.standard_normal(counts.shape, dtype=np.float32)
    return Parts(replace(transient, counts=seen), replace(transient, counts=counts - seen), unit)


def quarter_of(counts: npt.NDArray[np.uint64], rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Each photon with probability 1/4: binomial draws, three times as fast by a bit for each photon (NumPy 2)."""
    if not hasattr(np, "bitwise_count"):
        return np.asarray(rng.binomial(counts.astype(np.int64), 1 - KEPT), dtype=np.int64)
    one_in_four = rng.integers(0, MOST, counts.shape, np.uint64, True) & rng.integers(
        0, MOST, counts.shape, np.uint64, True
    )
    photons = np.left_shift(np.uint64(1), np.minimum(counts, BITS)) - np.uint64(1)
    drawn: npt.NDArray[np.int64] = np.bitwise_count(one_in_four & photons).astype(np.int64)
    many = np.nonzero(counts > BITS)
    drawn[many] = rng.binomial(counts[many].astype(np.int64), 1 - KEPT)
    return drawn


def photon_unit(transient: Transient) -> float:
    """The variance of a count over its mean: 1 for whole counts; else from second differences along time, which light
    hardly has and noise does. 0 where there is no noise."""
    return 1.0 if are_counts(transient.counts) else _difference(transient, 2) / 6


def photon_unit_of_sums(transient: Transient, joined: int) -> float:
    """The same of so many bins added up. Where light was moved by parts of a bin, a photon's noise lies in two of them:
    one bin has less of it, their sum all. From second and third differences, which tell noise of neighbouring bins that
    goes together (6 and 20 times the variance, less 8 and 30 times the covariance)."""
    if joined == 1 or are_counts(transient.counts):
        return photon_unit(transient)
    second, third = _difference(transient, 2), _difference(transient, 3)
    variance, covariance = (30 * second - 8 * third) / 20, (20 * second - 6 * third) / 20
    return max(variance + 2 * covariance * (joined - 1) / joined, second / 6)


def _difference(transient: Transient, order: int) -> float:
    """The mean square of differences along time over the mean count; 0 where there is nothing."""
    chosen = transient.counts[:, transient.exposure_s > 0]
    chosen = chosen[:, :: max(1, chosen.shape[1] // 512)]
    mean = float(chosen.mean(dtype=np.float64))
    if len(chosen) <= order or mean <= 0:
        return 0.0
    return float(np.mean(np.diff(chosen, order, axis=0).astype(np.float64) ** 2)) / mean


def are_counts(counts: npt.NDArray[np.float32]) -> bool:
    """Whether every number is a whole one and none is below 0."""
    return bool((counts >= 0).all() and (counts == np.rint(counts)).all())
