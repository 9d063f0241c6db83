"""slices.png: three slices through the brightest voxel - from the front, from the side, from above - on one scale."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from nlos.recon.errors import InvalidData
from nlos.recon.own_style import own_style
from nlos.recon.pictures import extent, save_picture
from nlos.recon.seen import FAINT
from nlos.recon.small_print import below, small_print
from nlos.recon.volume import Reconstruction, Volume

MARK = "#56b4e9"
MARKED = 0.1
"""Of a panel's side, at either end: a line through all of it would hide the surface that it goes through."""
BEHIND = 1.15
"""Of the farthest depth where anything is seen: so much is shown."""
INCHES, LEAST_INCHES = 7.4, 4.0


@own_style()
def slices_picture(reconstruction: Reconstruction, path: Path) -> None:
    """Writes the PNG; marks at the edges say where each slice lies in the others.

    Raises `InvalidData` where the reconstruction holds no volume.
    """
    volume = reconstruction.volume
    if volume is None:
        raise InvalidData(f"this {reconstruction.method} reconstruction holds no volume. Make it without --no-volume.")
    plane, row, col = (int(i) for i in np.unravel_index(int(volume.albedo.argmax()), volume.albedo.shape))
    left, right, bottom, top = extent(reconstruction)
    near, far, shown = float(volume.depths_m[0]), float(volume.depths_m[-1]), _shown_m(volume)
    x_m, y_m, z_m = volume.wall.x_m()[col], volume.wall.y_m()[row], float(volume.depths_m[plane])
    across, up = _room(right - left, shown - near), _room(top - bottom, shown - near)
    inch_a_m = INCHES / max(sum(across), sum(up))
    size = (max(LEAST_INCHES, inch_a_m * sum(across) + 1.3), max(LEAST_INCHES, inch_a_m * sum(up) + 1.2))
    figure = Figure(figsize=size, layout="constrained")
    (front, side), (above, corner) = figure.subplots(2, 2, width_ratios=across, height_ratios=up)
    brightest = float(volume.albedo.max()) or 1.0
    drawn = _slice(front, volume.albedo[plane] / brightest, (left, right, bottom, top), (x_m, y_m))
    front.set(title=f"slice at z = {z_m:.3f} m, from the front", xlabel="x (m)", ylabel="y (m)")
    _slice(side, volume.albedo[:, :, col].T / brightest, (near, far, bottom, top), (z_m, y_m))
    side.set(title=f"slice at x = {x_m:.3f} m, from the side", xlabel="z, from the wall (m)", ylabel="y (m)")
    side.set_xlim(near, shown)
    _slice(above, volume.albedo[:, row] / brightest, (left, right, far, near), (x_m, z_m))
    above.set(title=f"slice at y = {y_m:.3f} m, from above", xlabel="x (m)", ylabel="z, from the wall (m)")
    above.set_ylim(shown, near)
    corner.set_axis_off()
    bar = corner.inset_axes((0.1, 0.7, 0.6, 0.05))
    figure.colorbar(
        drawn, cax=bar, orientation="horizontal", label=f"{reconstruction.method.upper()}: brightness (relative)"
    )
    words = "Through the brightest voxel.\nMarks at the edges: where\nthe other two slices lie"
    corner.text(0.1, 0.4, words, color="0.35", va="top", transform=corner.transAxes)
    below(figure, small_print(reconstruction), 6.5)
    save_picture(figure, path)


def _slice(
    axes: Axes, image: np.ndarray, sides: tuple[float, float, float, float], others: tuple[float, float]
) -> AxesImage:
    """`others`: where the two other slices cross this one."""
    drawn = axes.imshow(image, cmap="gray", vmin=0, vmax=1, extent=sides, interpolation="nearest")
    for begin, end in ((0, MARKED), (1 - MARKED, 1)):
        axes.axvline(others[0], begin, end, color=MARK, linewidth=1.2)
        axes.axhline(others[1], begin, end, color=MARK, linewidth=1.2)
    axes.locator_params(nbins=5)
    return drawn


def _room(wide: float, deep: float) -> list[float]:
    """What two views get of a side of the picture, in metres: neither less than a third of the other."""
    return [max(wide, deep / 3), max(deep, wide / 3)]


def _shown_m(volume: Volume) -> float:
    """Up to which depth: a little farther than anything is seen."""
    bright = volume.albedo.max(axis=(1, 2))
    seen = np.flatnonzero(bright > FAINT * float(bright.max()))
    last_m = float(volume.depths_m[-1])
    return min(last_m, BEHIND * float(volume.depths_m[seen[-1]])) if len(seen) else last_m
