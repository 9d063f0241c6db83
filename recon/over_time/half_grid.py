"""Pictures of a film on half its grid, where NANO's operator has no more points either: a third of the time."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.over_time.given import Given
from nlos.recon.over_time.moments import Moments, added
from nlos.recon.volume import Reconstruction

Floats = npt.NDArray[np.float64]
FINER_THAN = 32
"""Points a side; grids that are no finer are left as they are."""


@dataclass(frozen=True, eq=False)
class HalfGrid:
    """Light on half the grid of `wall`. Its points lie `shift_m` (x, y) off the middle of their cells on average, those
    of a frame of an interleaved scan all alike: so far aside the picture belongs."""

    light: Transient
    wall: WallGrid
    shift_m: tuple[float, float] = (0.0, 0.0)
    given: Given | None = None
    """Where the light is a film's: what a network for films is told of it."""

    def enlarged(self, made: Reconstruction) -> Reconstruction:
        """A picture of the light on the whole grid: brightness by cubic splines, depth that of the nearest cell. The
        volume stays behind."""
        if made.wall == self.wall:
            return made
        row = _cells(-self.wall.y_m() + self.shift_m[1], made.wall.height_m, made.wall.rows)
        col = _cells(self.wall.x_m() - self.shift_m[0], made.wall.width_m, made.wall.cols)
        at = np.stack(np.meshgrid(row, col, indexing="ij"))
        albedo = scipy.ndimage.map_coordinates(made.albedo, at, order=3, mode="nearest")
        near = np.clip(np.rint(at).astype(np.intp), 0, np.array(made.albedo.shape)[:, None, None] - 1)
        return replace(
            made,
            albedo=np.clip(albedo, 0.0, float(made.albedo.max(initial=0.0))).astype(np.float32),
            depth_m=made.depth_m[near[0], near[1]],
            wall=self.wall,
            volume=None,
            intervals=None,
            confidence=None if made.confidence is None else made.confidence[near[0], near[1]],
        )


def on_half_grid(frames: list[Moments], weights: list[float]) -> HalfGrid:
    """Counts and exposures of several frames added up, the newest one last."""
    wall = frames[0].wall
    if max(wall.rows, wall.cols) <= FINER_THAN or wall.rows % 2 or wall.cols % 2:
        return HalfGrid(added(frames, weights), wall)
    half = WallGrid(wall.width_m, wall.height_m, wall.rows // 2, wall.cols // 2)
    light = added([replace(each, wall=half) for each in frames], weights)
    exposed_s = np.concatenate([each.exposure_s * weight for each, weight in zip(frames, weights, strict=True)])
    x_m, y_m = (np.concatenate([getattr(each, name) for each in frames]) for name in ("x_m", "y_m"))
    aside = (
        np.average(_aside(x_m, half.width_m, half.cols), weights=exposed_s),
        np.average(_aside(y_m, half.height_m, half.rows), weights=exposed_s),
    )
    return HalfGrid(light, wall, (float(aside[0]), float(aside[1])))


def _aside(at_m: Floats, side_m: float, count: int) -> Floats:
    """How far points (N,) lie from the middle of their cells."""
    return np.asarray(((at_m / side_m + 0.5) * count % 1 - 0.5) * side_m / count, dtype=np.float64)


def _cells(along_m: Floats, side_m: float, count: int) -> Floats:
    """Positions, in cells from the middle of the first."""
    return np.asarray((along_m / side_m + 0.5) * count - 0.5, dtype=np.float64)
