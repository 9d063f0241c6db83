"""A 3D view that stands still: for paper, where nothing turns."""

from matplotlib.figure import Figure

from nlos.recon.seen import SOLID
from nlos.recon.view3d import solid_points
from nlos.recon.volume import Reconstruction

MOST_POINTS = 8000


def still_figure(reconstruction: Reconstruction) -> Figure:
    """The bright voxels, or the front surface, behind the wall; near is yellow, as in the depth picture."""
    points, value = solid_points(reconstruction)
    keep = value >= SOLID
    points = points[keep][-MOST_POINTS:]
    figure = Figure(figsize=(6.4, 4.8), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    wall = reconstruction.wall
    x, y = wall.width_m / 2, wall.height_m / 2
    axes.plot([-x, x, x, -x, -x], [0, 0, 0, 0, 0], [-y, -y, y, y, -y], color="0.3", linewidth=1)
    if len(points):
        axes.scatter(points[:, 0], points[:, 2], points[:, 1], c=points[:, 2], cmap="viridis_r", s=5, linewidths=0)
        axes.set_ylim(0, max(float(points[:, 2].max()) * 1.05, 0.1))
    axes.set(xlabel="x (m)", ylabel="z, from the wall (m)", zlabel="y (m)", xlim=(-x, x), zlim=(-y, y))
    axes.set_box_aspect((2 * x, axes.get_ylim()[1], 2 * y))
    axes.view_init(elev=14, azim=-62)
    return figure
