"""A scan in two parts with independent noise: one to reconstruct from, one to judge the picture by."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import EXACT, Transient
from nlos.acquisition.wall import WallGrid

KEPT = 0.75
"""The share of the light that the picture is made from; the rest judges it."""
FEWEST_POINTS = 24  # a side, below which nothing is added up
SEED = 20180305
BITS, MOST = np.uint64(63), 2**64 - 1
MOST_PHOTONS, ROUNDING = 2.0**18, 1e-6
"""In one bin, of counts in an unknown unit, and by how much float32 may miss a whole one: more would pass for whole."""
PLANES = 64
"""Of one time each, looked at together: some memory, whatever the record."""


@dataclass(frozen=True)
class CountNoise:
    """The variance of a count is `unit` times what it would be had nothing been subtracted from it."""

    unit: float
    """What one photon counts: the variance of a count over its mean."""
    level: float = 0.0
    """What was subtracted from a bin, a second."""
    beside: float = 0.0
    """Covariance of neighbouring bins over their variance, where light was moved by parts of a bin."""

    def deviation(self, counts: npt.NDArray[Any], share: float = 1.0) -> npt.NDArray[Any]:
        """The root of a share of the variance of counts, what was subtracted added to them again. Where more was than
        anybody knows, as a direct pulse's tail, what lies below nothing is chance, and as much of it lies above."""
        of = counts.dtype.type
        light = of(np.sqrt(share * self.unit)) * np.sqrt(np.maximum(counts, 0))  # their product may be out of float32
        return np.asarray(light + of(np.sqrt(2 * share)) * np.maximum(-counts, 0))

    def of_sums(self, joined: int) -> "CountNoise":
        """The same of so many bins added up."""
        grown = 1 + 2 * self.beside * (joined - 1) / joined
        return CountNoise(self.unit * grown, self.level * joined, self.beside / (joined * grown))


@dataclass(frozen=True)
class Parts:
    """Two scans of the same scene, as if they had lasted `KEPT` and 1 - `KEPT` of the time."""

    seen: Transient
    judging: Transient
    noise: CountNoise


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


def split(transient: Transient, noise: CountNoise, seed: int = SEED) -> Parts:
    """`transient` thinned: photon by photon where it holds whole ones (of `unit` each), which leaves two independent
    Poisson scans; else by Gaussian noise of the variance found in it, which does the same for its noise."""
    rng = np.random.default_rng(seed)
    counts, unit = transient.counts, noise.unit
    if unit > 0 and are_multiples(counts, unit):
        photons = np.rint(counts / np.float32(unit)).astype(np.uint64)
        seen = counts - quarter_of(photons, rng).astype(counts.dtype) * np.float32(unit)
    else:
        photons = counts + np.float32(noise.level) * transient.exposure_s.astype(np.float32) * (counts != 0)
        spread = noise.deviation(photons, KEPT * (1 - KEPT))
        seen = np.float32(KEPT) * counts + spread * _white(counts.shape, noise.beside, rng)
    return Parts(replace(transient, counts=seen), replace(transient, counts=counts - seen), noise)


def _white(shape: tuple[int, ...], beside: float, rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """Gaussian noise of variance 1 whose neighbours along the first axis have the covariance `beside`."""
    if beside == 0:
        return rng.standard_normal(shape, dtype=np.float32)
    drawn = rng.standard_normal((shape[0] + 1, *shape[1:]), dtype=np.float32)
    both, one = np.float32(np.sqrt(1 + 2 * beside)), np.float32(np.sqrt(1 - 2 * beside))
    return np.asarray((both + one) * drawn[1:] + (both - one) * drawn[:-1], dtype=np.float32) / np.float32(2)


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
    """The variance of a count over its mean: what one photon counts where they are whole; else from second differences
    along time, which light hardly has and noise does. 0 where there is no noise."""
    return counted_in(transient) or _difference(transient, 2) / 6


def photon_unit_of_sums(transient: Transient, joined: int) -> float:
    """The same of so many bins added up. Where light was moved by parts of a bin, a photon's noise lies in two of them:
    one bin has less of it, their sum all. From second and third differences, which tell noise of neighbouring bins that
    goes together (6 and 20 times the variance, less 8 and 30 times the covariance)."""
    whole = counted_in(transient)
    if joined == 1 or whole:
        return whole or photon_unit(transient)
    second, third = _difference(transient, 2), _difference(transient, 3)
    variance, covariance = (30 * second - 8 * third) / 20, (20 * second - 6 * third) / 20
    return max(variance + 2 * covariance * (joined - 1) / joined, second / 6)


def _difference(transient: Transient, order: int) -> float:
    """The mean square of differences along time over the mean count; 0 where there is nothing."""
    row, col = np.nonzero(transient.exposure_s > 0)
    some = slice(None, None, max(1, len(row) // 512))
    chosen = transient.counts[:, row[some], col[some]]
    mean = float(chosen.mean(dtype=np.float64))
    if len(chosen) <= order or mean <= 0:
        return 0.0
    return float(np.mean(np.diff(chosen, order, axis=0).astype(np.float64) ** 2)) / mean


def counted_in(transient: Transient) -> float:
    """What one photon counts where they are whole, in whatever unit: all counts are whole multiples of the smallest, or
    whole numbers (1). 0 where they are neither, as after corrections."""
    counts = transient.counts
    least, most = float(np.min(counts, where=counts > 0, initial=np.inf)), float(counts.max())
    if 0 < most <= MOST_PHOTONS * least and are_multiples(counts, least):
        return least
    return 1.0 if are_multiples(counts, 1.0) else 0.0


def are_multiples(counts: npt.NDArray[np.float32], unit: float) -> bool:
    """Whether every number is a whole multiple of `unit`, as far as float32 can tell, and none is below 0. From `EXACT`
    on all are, photons or not: then most of what is not 0 must lie below."""
    if not (counts >= 0).all() or 2 * np.count_nonzero(counts >= EXACT * unit) > np.count_nonzero(counts):
        return False
    firsts, planes = counts[:, :1], (counts[at : at + PLANES] for at in range(0, len(counts), PLANES))
    for part in (firsts, *planes):  # what are none mostly show it in their first
        steps = part / np.float32(unit)
        if not (np.abs(steps - np.rint(steps)) <= np.minimum(ROUNDING * steps, 0.25)).all():
            return False
    return True
