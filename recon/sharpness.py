"""How sharply the light of a scan comes together, for a wall of the size that it says or of another one.

A point's light lies on a paraboloid over the wall, in squared time; its curvature is that of the wall's scale. The
light-cone transform of another curvature does not bring it together.
"""

from dataclasses import replace

import numpy as np

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.explained_parts import coarser
from nlos.recon.without_torch.lct import PlainLightConeTransform, Settings

POINTS = 32  # a side, at most
FEWEST_BINS = 80


def sharpness(scan: Transient, scale: float) -> float:
    """The mean fourth power over the squared mean square of what the light-cone transform sees in `scan` with its wall
    `scale` times as large, on a coarse grid. Higher is sharper."""
    small = _small(scan)
    wall, time = small.wall, small.time
    wall = WallGrid(scale * wall.width_m, scale * wall.height_m, wall.rows, wall.cols)
    seen = PlainLightConeTransform(Settings(), wall, time).volume(small.counts, small.exposure_s).astype(np.float64)
    return float((seen**4).mean()) / max(float((seen**2).mean()) ** 2, 1e-300)


def _small(scan: Transient) -> Transient:
    """At most `POINTS` points a side, in bins that are about as deep as half a point's pitch."""
    while min(scan.wall.rows, scan.wall.cols) > POINTS:
        scan = coarser(scan)
    wall, time = scan.wall, scan.time
    pitch_m = min(wall.width_m / wall.cols, wall.height_m / wall.rows)
    joined = int(1.5 * pitch_m / (2 * SPEED_OF_LIGHT_M_PER_S) / time.bin_width_s)
    joined = max(1, min(joined, time.bins // FEWEST_BINS))
    bins = time.bins // joined
    counts = scan.counts[: bins * joined].reshape(bins, joined, wall.rows, wall.cols).sum(axis=1, dtype=np.float32)
    return replace(scan, counts=counts, time=TimeAxis(bins, joined * time.bin_width_s, time.start_s))
