"""What one sees of a volume from the wall: its brightest voxel along every line of sight, and how deep it lies."""

import numpy as np
import numpy.typing as npt

from recon.volume import Volume

SEEN_FRACTION = 0.1  # of the bright parts' level; what is darker has no depth


def front_view(volume: Volume) -> npt.NDArray[np.float32]:
    """The maximum along depth, (H, W)."""
    return np.asarray(volume.albedo.max(axis=0), dtype=np.float32)


def depth_map(volume: Volume) -> npt.NDArray[np.float32]:
    """Depth of the maximum in metres, (H, W), between planes by a parabola; NaN where nothing is seen."""
    albedo, depths_m = volume.albedo, volume.depths_m
    peak = albedo.argmax(axis=0)
    depth_m = depths_m[peak]
    if len(depths_m) > 2:
        middle = np.clip(peak, 1, len(depths_m) - 2)
        before, at, after = (
            np.take_along_axis(albedo, (middle + k)[None], 0)[0].astype(np.float64) for k in (-1, 0, 1)
        )
        curvature = before - 2 * at + after
        offset = np.divide(0.5 * (before - after), curvature, out=np.zeros_like(at), where=curvature < 0)
        pitch_m = (depths_m[-1] - depths_m[0]) / (len(depths_m) - 1)
        depth_m = depths_m[middle] + np.clip(offset, -1, 1) * pitch_m
    front = albedo.max(axis=0)
    bright = np.quantile(front, 0.99)
    return np.where(front > SEEN_FRACTION * bright, depth_m, np.nan).astype(np.float32)
