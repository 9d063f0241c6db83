"""What a reconstruction is: a volume of albedo behind the wall, its front view and its depth map."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.wall import WallGrid


@dataclass(frozen=True)
class Volume:
    """Albedo in arbitrary units at depths in front of the wall (z from the wall towards the hidden scene)."""

    albedo: npt.NDArray[np.float32]  # (D, H, W)
    depths_m: npt.NDArray[np.float64]  # (D,)
    wall: WallGrid


@dataclass(frozen=True)
class Reconstruction:
    """Front view and depth map, NaN where nothing is seen; the volume where the method has one."""

    albedo: npt.NDArray[np.float32]  # (H, W)
    depth_m: npt.NDArray[np.float32]  # (H, W)
    wall: WallGrid
    method: str
    seconds: float
    settings: dict[str, Any] = field(default_factory=dict)
    volume: Volume | None = None
    weights_sha256: str | None = None
    """Of the weights file, for learned methods."""
    confidence: npt.NDArray[np.float32] | None = None
    """(H, W), 0 to 1: how well the wall was measured at each point; see `gridding.confidence`."""
