"""By how much what a frame shows is displaced against another frame: their volumes, correlated."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.over_time.moments import Moments
from nlos.recon.without_torch.lct import PlainLightConeTransform, Settings

Floats = npt.NDArray[np.float64]
ACROSS = 32
"""Cells of the volumes along the wall's longer side, at most."""
LOW = 0.3
"""Of a volume's highest: below that it may be noise."""
DEEP = 3
"""Cells in depth per cell along the wall: arrivals tell depths that much better."""


@dataclass(frozen=True, eq=False)
class Seen:
    """The volume of one frame, as its spectrum, ready to be correlated."""

    spectrum: npt.NDArray[np.complex64]
    energy: float
    """The sum of its squares; 0 where there is nothing."""
    depth_m: float
    """Where most of it is."""
    repeats: float
    """How well a second frame of as many photons would agree with it, at best: from halves of its photons, by Spearman
    and Brown's formula (1910)."""


class Registration:
    """Volumes by the light-cone transform on a coarse grid. Points that were not measured count as dark: filled from
    their neighbours, they would pull what is seen towards the points that were."""

    def __init__(self, wall: WallGrid, time: TimeAxis) -> None:
        longer = wall.longer_m
        cells = min(max(wall.rows, wall.cols), ACROSS)
        rows, cols = (max(2, round(cells * side / longer)) for side in (wall.height_m, wall.width_m))
        self.wall = WallGrid(wall.width_m, wall.height_m, rows, cols)
        wanted_s = 2 * longer / cells / DEEP / SPEED_OF_LIGHT_M_PER_S
        self._factor = max(1, round(wanted_s / time.bin_width_s))
        self._time = TimeAxis(time.bins // self._factor, time.bin_width_s * self._factor, time.start_s)
        self._invert = PlainLightConeTransform(Settings(), self.wall, self._time)
        depth_m = self._time.bin_width_s * SPEED_OF_LIGHT_M_PER_S / 2
        self._cell_m = np.array([wall.width_m / cols, -wall.height_m / rows, depth_m])  # x, y, z

    def seen(self, points: Moments, repeats: float | None = None) -> Seen:
        """What these points show; `repeats` where it is known from another look at them."""
        counts = self._on_grid(points)
        repeats = self._repeats(points, counts) if repeats is None else repeats
        volume = self._volume(counts) / max(float(points.exposure_s.sum()), 1e-30)
        power = np.maximum(volume, 0.0).astype(np.float64).sum(axis=(1, 2)) ** 2
        depth_m = float(np.average(self._invert.depths_m, weights=power)) if power.any() else 0.0
        return Seen(scipy.fft.rfftn(volume), float((volume**2).sum()), depth_m, repeats)

    def _repeats(self, points: Moments, counts: npt.NDArray[np.float32]) -> float:
        """See `Seen`; `counts` (T, H, W) are those of the points on the grid."""
        rng = np.random.default_rng(len(points.x_m))
        drawn = np.zeros_like(points.counts)
        lit = points.counts > 0
        drawn[lit] = rng.binomial(np.rint(points.counts[lit]).astype(np.int64), 0.5)
        half = self._on_grid(replace(points, counts=drawn))
        one, other = (self._volume(each) for each in (half, counts - half))
        norm = float(np.sqrt((one**2).sum() * (other**2).sum()))
        halves = max(float((one * other).sum()) / norm, 0.0) if norm > 0 else 0.0
        return 2 * halves / (1 + halves)

    def volume_of(self, seen: Seen) -> tuple[npt.NDArray[np.float32], Floats]:
        """The volume (D, h, w) that was made of it, less its mean, and the depths of its planes (D,)."""
        made = scipy.fft.irfftn(seen.spectrum, (self._time.bins, self.wall.rows, self.wall.cols))
        return np.asarray(made, dtype=np.float32), self._invert.depths_m

    def front_of(self, seen: Seen) -> tuple[npt.NDArray[np.float32], Floats]:
        """That volume from the wall (h, w): its highest over depth, and where that is, NaN where it is low."""
        volume, depths_m = self.volume_of(seen)
        light = np.maximum(volume, 0.0).max(axis=0)
        return light, np.where(light > LOW * light.max(initial=0.0), depths_m[volume.argmax(axis=0)], np.nan)

    @property
    def cell_m(self) -> float:
        """The larger side of a cell."""
        return float(np.abs(self._cell_m[:2]).max())

    def _volume(self, counts: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        volume = self._invert.volume(counts, np.ones(counts.shape[1:]))
        return np.asarray(volume - volume.mean(), dtype=np.float32)

    def displacement(self, before: Seen, now: Seen, most_m: float) -> tuple[Floats, float]:
        """x, y, z (3,) in metres from `before` to `now`, at most `most_m` along each, and the height of the
        correlation there, to be compared with `energy`."""
        shape = (self._time.bins, self.wall.rows, self.wall.cols)
        both = np.fft.fftshift(scipy.fft.irfftn(now.spectrum * before.spectrum.conj(), shape))
        middle = [side // 2 for side in shape]
        reach = [
            min(int(np.ceil(most_m / abs(cell))), half - 1)
            for cell, half in zip(self._cell_m[::-1], middle, strict=True)
        ]
        near = both[tuple(slice(m - r, m + r + 1) for m, r in zip(middle, reach, strict=True))]
        peak = np.unravel_index(int(near.argmax()), near.shape)
        place = [at - half + _vertex(near, peak, axis) for axis, (at, half) in enumerate(zip(peak, reach, strict=True))]
        return np.array(place[::-1]) * self._cell_m, float(near[peak])

    def _on_grid(self, points: Moments) -> npt.NDArray[np.float32]:
        """Counts (T, H, W), each point's shared by the four cells around it."""
        wall, bins = self.wall, self._time.bins
        counts = points.counts[:, : bins * self._factor].reshape(len(points.x_m), bins, self._factor).sum(axis=2)
        row, col = (0.5 - points.y_m / wall.height_m) * wall.rows - 0.5, (points.x_m / wall.width_m + 0.5) * wall.cols
        col = col - 0.5
        above, left = np.floor(row), np.floor(col)
        r, c = np.stack([above, above, above + 1, above + 1]), np.stack([left, left + 1, left, left + 1])
        share = (1 - np.abs(row - r)) * (1 - np.abs(col - c))
        on = (r >= 0) & (r < wall.rows) & (c >= 0) & (c < wall.cols)
        cell, point = (r * wall.cols + c)[on].astype(np.intp), np.nonzero(on)[1]
        shape = (wall.rows * wall.cols, len(counts))
        shared = scipy.sparse.csr_array((share[on].astype(np.float32), (cell, point)), shape)
        return np.ascontiguousarray((shared @ counts).T).reshape(bins, wall.rows, wall.cols)


def _vertex(values: npt.NDArray[np.floating], peak: tuple[np.intp, ...], axis: int) -> float:
    """How far the top of the parabola through a peak and its neighbours lies from it, in cells."""
    at = int(peak[axis])
    if not 0 < at < values.shape[axis] - 1:
        return 0.0
    before, top, after = (float(values[(*peak[:axis], at + step, *peak[axis + 1 :])]) for step in (-1, 0, 1))
    bend = before - 2 * top + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0
