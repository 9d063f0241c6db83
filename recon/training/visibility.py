"""Which wall points a surfel sees past the rest of the scene: rays marched through the front view's depth map."""

import numpy as np
import torch

from nlos.acquisition.wall import WallGrid
from nlos.recon.training.scenes import Scene, Surfels
from nlos.recon.training.shapes import Array

STEPS = 32
CLEAR = 1.5 / STEPS  # part of the ray nearest to the surfel, where only its own surface is
COARSE = 8


def visibility(scene: Scene, surfels: Surfels, wall: WallGrid, device: str = "cpu") -> Array:
    """Share of light that gets through, (S, COARSE, COARSE): 0 or 1 at the centres of a coarse grid over `wall`.

    A ray is stopped where it passes through the surface that the front view shows. What lies behind that surface is
    not known, so bodies count as thin.
    """
    coarse = WallGrid(wall.width_m, wall.height_m, COARSE, COARSE)
    target = np.stack(np.meshgrid(coarse.x_m(), coarse.y_m()), axis=-1).reshape(-1, 2).astype(np.float32)
    start, aim = torch.from_numpy(surfels.position_m).to(device), torch.from_numpy(target).to(device)
    depth = torch.from_numpy(scene.depth_m).to(device)
    rows, cols = depth.shape
    free = torch.ones(len(start), len(aim), dtype=torch.bool, device=device)
    for k in range(int(STEPS * CLEAR) + 1, STEPS):
        at = (k + 0.5) / STEPS
        x = start[:, None, 0] * (1 - at) + aim[None, :, 0] * at
        y = start[:, None, 1] * (1 - at) + aim[None, :, 1] * at
        col = ((x / scene.wall.width_m + 0.5) * cols).long()
        row = ((0.5 - y / scene.wall.height_m) * rows).long()
        inside = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
        surface = depth[torch.where(inside, row, 0), torch.where(inside, col, 0)]
        far, near = start[:, None, 2] * (1 - k / STEPS), start[:, None, 2] * (1 - (k + 1) / STEPS)
        free &= ~(inside & (near < surface) & (surface <= far))
    return free.view(-1, COARSE, COARSE).float().cpu().numpy()


def spread(seen: torch.Tensor, wall: WallGrid) -> torch.Tensor:
    """(S, COARSE, COARSE) -> (S, H W), between the coarse points linearly."""
    fine = torch.nn.functional.interpolate(seen[None], size=(wall.rows, wall.cols), mode="bilinear")
    return fine[0].flatten(1)
