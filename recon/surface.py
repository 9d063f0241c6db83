"""The front surface of a reconstruction as points and quadrilaterals, for those who draw or export it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.recon.seen import STEP_PIXELS, brightest, visible_depth
from nlos.recon.volume import Reconstruction


@dataclass(frozen=True)
class Surface:
    """Pixels that are seen (`FAINT` in `seen.py`), and the quadrilaterals between neighbouring ones."""

    points_m: npt.NDArray[np.float32]  # (N, 3): x, y, z from the wall
    albedo: npt.NDArray[np.float32]  # (N,), 0 to 1
    quads: npt.NDArray[np.int32]  # (M, 4), counter-clockwise for who stands at the wall: their front is towards it


def front_surface(reconstruction: Reconstruction) -> Surface:
    """What is seen from the wall; empty where nothing is."""
    wall, depth_m = reconstruction.wall, visible_depth(reconstruction)
    seen = np.isfinite(depth_m)
    x, y = np.meshgrid(wall.x_m(), wall.y_m())
    points = np.stack([x[seen], y[seen], depth_m[seen]], axis=1).astype(np.float32)
    albedo = np.clip(reconstruction.albedo[seen] / brightest(reconstruction), 0, 1).astype(np.float32)
    number = np.full(depth_m.shape, -1, dtype=np.int32)
    number[seen] = np.arange(int(seen.sum()), dtype=np.int32)
    corners = [number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]]
    depths = np.stack([depth_m[:-1, :-1], depth_m[:-1, 1:], depth_m[1:, 1:], depth_m[1:, :-1]])
    whole = np.all([corner >= 0 for corner in corners], axis=0)
    pitch_m = max(wall.width_m / wall.cols, wall.height_m / wall.rows)
    step = np.zeros(whole.shape)
    step[whole] = np.ptp(depths[:, whole], axis=0)
    kept = whole & (step <= STEP_PIXELS * pitch_m)
    return Surface(points, albedo, np.stack([corner[kept] for corner in corners], axis=1).astype(np.int32))


def vertex_normals(surface: Surface) -> npt.NDArray[np.float32]:
    """Unit normals of the points, (N, 3), towards the wall: the sum over the faces around each; towards the wall where
    there is none."""
    corners = surface.points_m[surface.quads].astype(np.float64)  # (M, 4, 3)
    across = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals = np.zeros((len(surface.points_m), 3))
    for corner in range(4):
        np.add.at(normals, surface.quads[:, corner], across)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    facing = np.where(length > 0, normals / np.maximum(length, 1e-30), np.array([0.0, 0.0, -1.0]))
    return np.asarray(facing, dtype=np.float32)
