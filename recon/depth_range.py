"""A reconstruction limited to a range of depths, for scenes whose depth is known beforehand."""

from dataclasses import replace

import numpy as np

from nlos.recon.errors import InvalidSettings
from nlos.recon.front_view import depth_map, front_view
from nlos.recon.volume import Reconstruction, Volume


def within_depths(result: Reconstruction, nearest_m: float, farthest_m: float) -> Reconstruction:
    """What `result` has from `nearest_m` to `farthest_m` behind the wall: a volume's planes there and the view of them;
    of a picture without a volume, the pixels whose depth lies there. Raises `InvalidSettings` where there is nothing.
    """
    if result.volume is None:
        there = (result.depth_m >= nearest_m) & (result.depth_m <= farthest_m)
        return replace(
            result,
            albedo=np.where(there, result.albedo, 0).astype(np.float32),
            depth_m=np.where(there, result.depth_m, np.nan).astype(np.float32),
        )
    depths_m = result.volume.depths_m
    planes = (depths_m >= nearest_m) & (depths_m <= farthest_m)
    if not planes.any():
        raise InvalidSettings(
            f"no depth of the volume lies between {nearest_m:g} and {farthest_m:g} m; it reaches from "
            f"{depths_m[0]:.3g} to {depths_m[-1]:.3g} m"
        )
    volume = Volume(result.volume.albedo[planes], depths_m[planes], result.volume.wall)
    depth_m = depth_map(volume.albedo, volume.depths_m)
    # Of a surface that is still the brightest, the method's own depth: it may know better than the volume's maximum.
    kept = planes[result.volume.albedo.argmax(axis=0)] & np.isfinite(depth_m) & np.isfinite(result.depth_m)
    return replace(
        result,
        volume=volume,
        albedo=front_view(volume.albedo),
        depth_m=np.where(kept, result.depth_m, depth_m).astype(np.float32),
    )
