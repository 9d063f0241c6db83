"""Whether the points of a scan lie on the wall where it says: neighbours record light that is almost the same.

Light from a surface reaches two points of the wall at most 2 d / c apart, d their distance, whatever the surface. In
bins no narrower than that, a point's light differs less from its neighbour's than from that of the next but one: by the
squares, 0.3 to 0.6 of it. Points in any other order have no such neighbours.
"""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, Transient
from nlos.recon.count_noise import noise_of_sums

MIXED = 0.6
"""Squares next to each other over those two apart, along rows and along columns, from which on points are mixed up."""
SHIFTED = 1.0
"""The same along one of them: every second line is reversed or shifted."""
ERRORS = 2.0
"""Standard errors by which a ratio must be above."""
JUMPS = 0.25
"""Share of the light's way between neighbours, there and back, from which on time zero jumps between lines ..."""
JUMP_ERRORS = 4.0
"""... and its standard errors."""
FEWEST_PAIRS = 50
FEWEST_LINES = 6
LIT = 0.05
"""Share of the brightest bin's light, all lines together, from which on a bin is one of those that hold it."""
Floats = npt.NDArray[np.float64]


def out_of_order(transient: Transient) -> str:
    """What to tell who believes the order of the points; empty where nothing speaks against it, or too few points have
    neighbours."""
    ratios = [_least_ratio(transient, axis) for axis in (0, 1)]
    least = [low for low in ratios if low is not None]
    if len(least) == 2 and min(least) > MIXED:
        return (
            "neighbouring points differ as points far apart do: check their order, how evenly they were lit, and that "
            "nothing moved"
        )
    if jumps_s := max((_jumps_s(transient, axis) for axis, low in enumerate(ratios) if low and low > MIXED), default=0):
        return (
            f"time zero jumps by {jumps_s * 1e12:.0f} ps from line to line of the wall: check the trigger; of a raw "
            "scan, direct light tells it at each point"
        )
    if least and max(least) > SHIFTED:
        return "every second line of the wall differs from those beside it: check their direction and the mirror's lag"
    return ""


def _jumps_s(transient: Transient, axis: int) -> float:
    """Standard deviation by which the light of whole rows (0) or columns (1) comes earlier or later than that of those
    beside them, in seconds; 0 where it is no more than chance, or than light that a lag of the mirror moves along a
    line: that leaves a line's light together when it comes."""
    wall, time = transient.wall, transient.time
    lines = transient.counts.sum(axis=2 - axis, dtype=np.float64)  # [T, lines]
    light = np.maximum(lines - np.median(lines, axis=0), 0)
    lit = light.sum(axis=1) > LIT * light.sum(axis=1).max()
    lines, light, bins = lines[lit], light[lit], np.flatnonzero(lit)[:, None].astype(np.float64)
    total = np.maximum(light.sum(axis=0), 1e-300)
    mean = (bins * light).sum(axis=0) / total
    noise = noise_of_sums(transient, 1)
    photons = lines + noise.level * transient.exposure_s.sum(axis=1 - axis)
    error = np.sqrt(((bins - mean) ** 2 * np.maximum(photons, 0)).sum(axis=0)) / total
    there = total > total.max() / 4
    inner = there[1:-1] & there[2:] & there[:-2]
    if inner.sum() < FEWEST_LINES:
        return 0.0
    beside = mean[1:-1] - (mean[2:] + mean[:-2]) / 2
    jump = 1.48 * float(np.median(np.abs(beside[inner])) / np.sqrt(1.5))  # a line or two may be spoilt otherwise
    chance = float(np.sqrt(np.mean(error[1:-1][inner] ** 2) * noise.unit))
    pitch_m = (wall.height_m / wall.rows, wall.width_m / wall.cols)[axis]
    least = max(JUMPS * 2 * pitch_m / SPEED_OF_LIGHT_M_PER_S / time.bin_width_s, JUMP_ERRORS * chance)
    return jump * time.bin_width_s if jump > least else 0.0


def _least_ratio(transient: Transient, axis: int) -> float | None:
    """Mean square of differences of neighbours along rows (1) or columns (0) over that of points two apart, what noise
    adds taken off; less `ERRORS` standard errors, from line to line. None where points two apart hardly differ."""
    wall, time = transient.wall, transient.time
    pitch_m = (wall.height_m / wall.rows, wall.width_m / wall.cols)[axis]
    joined = max(1, int(np.ceil(2 * pitch_m / (SPEED_OF_LIGHT_M_PER_S * time.bin_width_s))))
    bins, noise = time.bins // joined, noise_of_sums(transient, joined)
    counts = transient.counts[: bins * joined].reshape(bins, joined, wall.rows, wall.cols).sum(axis=1, dtype=np.float64)
    measured = transient.exposure_s > 0
    dwell = np.where(measured, transient.exposure_s / max(float(transient.exposure_s.max()), 1e-300), np.inf)
    variance = noise.deviation(counts + noise.level * transient.exposure_s) ** 2
    lines = [np.moveaxis(each, axis - 2, -1) for each in (counts / dwell, variance / dwell**2)]
    there = np.moveaxis(measured, axis, -1)
    near, far = (_squares(lines[0], lines[1], there, apart) for apart in (1, 2))
    if near is None or far is None:
        return None
    total = float(far.sum())
    if not total > 3 * float(np.sqrt(len(far) * far.var())):
        return None
    ratio = float(near.sum()) / total
    return ratio - ERRORS * float(np.sqrt(len(far) * (near - ratio * far).var())) / total


def _squares(rates: Floats, variances: Floats, there: npt.NDArray[np.bool_], apart: int) -> Floats | None:
    """Of each line, its part of the mean square of differences (K, lines, points) so far apart, without noise."""
    pairs = there[:, apart:] & there[:, :-apart]
    if pairs.sum() < FEWEST_PAIRS:
        return None
    differences = (rates[..., apart:] - rates[..., :-apart]) ** 2 - variances[..., apart:] - variances[..., :-apart]
    return np.asarray((differences.sum(axis=0) * pairs).sum(axis=1) / pairs.sum())
