"""What a picture shows, told in figures to who cannot see it."""

from typing import TYPE_CHECKING

import numpy as np

from nlos.recon.seen import depth_span, visible_depth

if TYPE_CHECKING:
    from nlos.recon.volume import Reconstruction


def in_words(result: "Reconstruction") -> str:
    """Depths, extent and the brightest place of what is seen."""
    seen = np.isfinite(visible_depth(result))
    span_m, part, wall = depth_span([result]), 100 * float(seen.mean()), result.wall
    if span_m is None or not part:
        return "nothing is brighter than noise"
    row, col = np.unravel_index(int(np.argmax(result.albedo)), result.albedo.shape)
    rows, cols = np.nonzero(seen)
    x_m, y_m = wall.x_m(), wall.y_m()
    return (
        f"surfaces between {span_m[0]:.2f} and {span_m[1]:.2f} m from the wall in {part:.0f} % of the picture, x "
        f"{x_m[cols].min():.2f} to {x_m[cols].max():.2f} m, y {y_m[rows].min():.2f} to {y_m[rows].max():.2f} m; "
        f"brightest at x {x_m[col]:.2f} m, y {y_m[row]:.2f} m"
    )
