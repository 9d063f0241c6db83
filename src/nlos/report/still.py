"""A 3D view that stands still: for paper, where nothing turns."""

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from nlos.recon.own_style import own_style
from nlos.recon.seen import SOLID
from nlos.recon.view3d import solid_points
from nlos.recon.volume import Reconstruction

MOST_POINTS = 8000
DARK_ENOUGH = 0.5
LUMA = np.array([0.299, 0.587, 0.114])
Floats = npt.NDArray[np.float32]


@own_style()
def still_figure(reconstruction: Reconstruction) -> Figure:
    """The bright voxels, or the front surface, behind the wall; near is yellow, as in the depth picture, but no colour
    is too light for paper, and what is faint is pale."""
    points, value = solid_points(reconstruction)
    keep = value >= SOLID
    points = points[keep][-MOST_POINTS:]
    figure = Figure(figsize=(6.4, 4.8), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    wall = reconstruction.wall
    x, y = wall.width_m / 2, wall.height_m / 2
    axes.plot([-x, x, x, -x, -x], [0, 0, 0, 0, 0], [-y, -y, y, y, -y], color="0.3", linewidth=1)
    if len(points):
        colours = _readable(points[:, 2], value[keep][-MOST_POINTS:])
        axes.scatter(points[:, 0], points[:, 2], points[:, 1], c=colours, s=5, linewidths=0, depthshade=False)
        axes.set_ylim(0, max(float(points[:, 2].max()) * 1.05, 0.1))
    axes.set(xlabel="x (m)", ylabel="z, from the wall (m)", zlabel="y (m)", xlim=(-x, x), zlim=(-y, y))
    axes.set_box_aspect((2 * x, axes.get_ylim()[1], 2 * y))
    axes.view_init(elev=14, azim=-62)
    return figure


def _readable(depths_m: Floats, albedo: Floats) -> npt.NDArray[np.float64]:
    """Colours of points (N,) on white, (N, 4): hue by depth, strength by albedo."""
    span = float(np.ptp(depths_m)) or 1.0
    colours = np.asarray(matplotlib.colormaps["viridis_r"]((depths_m - depths_m.min()) / span))
    luma = colours[:, :3] @ LUMA
    colours[:, :3] *= np.minimum(1.0, DARK_ENOUGH / np.maximum(luma, 1e-3))[:, None]
    colours[:, 3] = 0.2 + 0.8 * np.sqrt(np.clip(albedo, 0, 1))
    return colours
