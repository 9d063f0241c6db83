"""The points of one frame with the moments at which each was exposed, and their light moved to another moment."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.gridding import grid_samples

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Moments:
    """The measured points of a frame, time 0 at the wall and no direct light."""

    x_m: Floats  # (N,)
    y_m: Floats  # (N,)
    counts: npt.NDArray[np.float32]  # (N, T)
    exposure_s: Floats  # (N,)
    taken_s: Floats  # (N,), the middle of each point's exposure
    wall: WallGrid
    time: TimeAxis

    @cached_property
    def mean_s(self) -> float:
        """The mean moment of exposure."""
        return float(np.average(self.taken_s, weights=self.exposure_s))

    @cached_property
    def photons(self) -> float:
        """In all of its bins."""
        return float(self.counts.sum(dtype=np.float64))

    @cached_property
    def lit(self) -> "Lit":
        """Where the counts are: most bins hold none, and what is held of a frame is moved many times."""
        flat = np.flatnonzero(self.counts)
        point, at = np.divmod(flat, self.time.bins)
        ways_m = self.time.centres_s() * (SPEED_OF_LIGHT_M_PER_S / 2)
        return Lit(point, self.counts.reshape(-1)[flat], (np.sign(ways_m) * ways_m**2)[at])


@dataclass(frozen=True, eq=False)
class Lit:
    """The bins of a frame that hold counts, (L,) each."""

    point: npt.NDArray[np.intp]
    counts: npt.NDArray[np.float32]
    squared_m2: Floats
    """The squares of their lengths of way, (ct / 2)^2, negative before time 0."""


def moments_of(frame: Transient, taken_s: Floats) -> Moments:
    """The points of a calibrated frame that were measured; `taken_s` (H, W), the middle of each one's exposure."""
    row, col = np.nonzero(frame.exposure_s > 0)
    counts = np.ascontiguousarray(frame.counts[:, row, col].T)
    places = frame.wall.x_m()[col], frame.wall.y_m()[row]
    return Moments(*places, counts, frame.exposure_s[row, col], taken_s[row, col], frame.wall, frame.time)


def moved(points: Moments, by_m: Floats, depth_m: float, seed: int) -> Moments:
    """The points as they would have been, had what they show been where it is `by_m` (N, 3: x, y, z) later and then
    `depth_m` away. Points that this moves off the wall are gone.

    An object's way along the wall moves its light along the wall; its way in depth moves arrivals, on the light cone's
    axis (ct / 2)^2, by the change of its depth squared, exactly so for one depth (O'Toole et al., Nature 2018). Whole
    counts go from bin to bin, rounded with a random share of a bin for each point: noise stays that of photons.
    """
    time, bins = points.time, points.time.bins
    x_m, y_m = points.x_m + by_m[:, 0], points.y_m + by_m[:, 1]
    on_wall = (np.abs(x_m) < points.wall.width_m / 2) & (np.abs(y_m) < points.wall.height_m / 2)
    counts = points.counts
    if by_m[on_wall, 2].any():
        lit = points.lit
        squared = lit.squared_m2 + (depth_m**2 - (depth_m - by_m[:, 2]) ** 2)[lit.point]
        shares = np.zeros(len(counts))
        shares[on_wall] = np.random.default_rng(seed).random(np.count_nonzero(on_wall)) - 0.5
        arrivals_bins = np.sqrt(np.maximum(squared, 0.0)) * (2 / SPEED_OF_LIGHT_M_PER_S / time.bin_width_s)
        first = shares - time.start_s / time.bin_width_s - 0.5
        index = np.rint(arrivals_bins + first[lit.point]).astype(np.intp)
        kept = (squared > 0) & (index >= 0) & (index < bins)
        flat = (lit.point * bins + index)[kept]
        counts = np.bincount(flat, lit.counts[kept], counts.size).reshape(counts.shape).astype(np.float32)
    if on_wall.all():
        return Moments(x_m, y_m, counts, points.exposure_s, points.taken_s, points.wall, time)
    exposure_s, taken_s = points.exposure_s[on_wall], points.taken_s[on_wall]
    return Moments(x_m[on_wall], y_m[on_wall], counts[on_wall], exposure_s, taken_s, points.wall, time)


def added(frames: list[Moments], weights: list[float]) -> Transient:
    """Counts and exposures of several frames on the wall's grid, each frame's by its weight."""
    some = [(frame, weight) for frame, weight in zip(frames, weights, strict=True) if weight > 0 and len(frame.x_m)]
    return grid_samples(
        np.concatenate([frame.x_m for frame, _ in some]),
        np.concatenate([frame.y_m for frame, _ in some]),
        np.concatenate([frame.counts * np.float32(weight) for frame, weight in some]),
        np.concatenate([frame.exposure_s * weight for frame, weight in some]),
        frames[0].wall,
        frames[0].time,
    )
