"""Pictures of a reconstruction: front view and depth, with axes in metres."""

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from nlos.recon.contours import contours
from nlos.recon.errors import InvalidData
from nlos.recon.own_style import own_style
from nlos.recon.pixel_marks import hatch, outline
from nlos.recon.png import write_png
from nlos.recon.seen import DOUBTFUL, FAINT, brightest, depth_limits, depth_opacity, visible_depth
from nlos.recon.small_print import below, small_print
from nlos.recon.volume import Reconstruction

DOTS_PER_INCH = 150
BACKGROUND = 0.88
OUTLINED = 0.5
"""A line goes around depths of at least so much of their colour: without colours the near end is as light as the
background, and what is pale would seem near."""
NOTHING = "This picture explains nothing of the light"
UNSEEN = "Nothing is seen in this picture"
MISPLACED = "Wall, time zero or order of points in doubt"


@own_style()
def albedo_picture(reconstruction: Reconstruction, path: Path) -> None:
    """The front view, brightest at its 99.9th percentile, as PNG."""
    _single(reconstruction, path, draw_albedo)


def draw_albedo(reconstruction: Reconstruction, figure: Figure, axes: Axes) -> None:
    """The front view with its colour bar."""
    drawn = axes.imshow(
        reconstruction.albedo / brightest(reconstruction), cmap="gray", vmin=0, vmax=1,
        extent=extent(reconstruction), interpolation="nearest",
    )  # fmt: skip
    doubt = ", hatched: likely no surface" if _hatched(axes, reconstruction) else ""
    figure.colorbar(drawn, ax=axes, label=f"brightness (relative){doubt}", shrink=0.85)
    _label(axes, f"{reconstruction.method.upper()}: front view")
    scale_bar(axes, reconstruction.wall.width_m, reconstruction.wall.height_m, "white")


@own_style()
def depth_picture(reconstruction: Reconstruction, path: Path) -> None:
    """The depth map in metres, fading into grey where little or nothing is seen, as PNG."""
    _single(reconstruction, path, draw_depth)


def draw_depth(
    reconstruction: Reconstruction, figure: Figure, axes: Axes, limits_m: tuple[float, float] | None = None
) -> None:
    """The depth map with its colour bar, by `depth_limits` unless other limits are given."""
    colours = matplotlib.colormaps["viridis_r"]
    low, high = limits_m or depth_limits([reconstruction])
    shown = visible_depth(reconstruction)
    scale = Normalize(low, high, clip=True)
    ink = depth_opacity(reconstruction)[..., None]
    colour = colours(scale(np.nan_to_num(shown, nan=low)))[..., :3]
    axes.imshow(ink * colour + (1 - ink) * BACKGROUND, extent=extent(reconstruction), interpolation="nearest")
    outline(axes, ink[..., 0] >= OUTLINED, extent(reconstruction))
    ends = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    seen = shown[np.isfinite(shown)]
    beyond = ends[bool((seen < low).any()), bool((seen > high).any())]
    lines = contours(reconstruction, (low, high))
    ruled = f"\na line every {lines.step_m * 100:g} cm" if lines else ""
    label = f"depth from the wall (m), pale: dim or doubtful{ruled}"
    bar = figure.colorbar(ScalarMappable(scale, colours), ax=axes, label=label, shrink=0.85, extend=beyond)
    if lines is not None:
        wall = reconstruction.wall
        axes.contour(wall.x_m(), wall.y_m(), lines.depth_m, lines.levels_m, colors="black", linewidths=0.5, alpha=0.6)
        bar.ax.hlines(lines.levels_m, 0, 1, color="black", linewidth=0.5, alpha=0.6)
    _label(axes, f"{reconstruction.method.upper()}: depth")
    scale_bar(axes, reconstruction.wall.width_m, reconstruction.wall.height_m, "0.25")


@own_style()
def summary_figure(reconstruction: Reconstruction, figure: Figure | None = None) -> Figure:
    """Front view and depth map side by side, on `figure` where one is given."""
    figure = figure or Figure()
    figure.set_size_inches(9.4, 4.2)
    figure.set_layout_engine("compressed")
    left, right = figure.subplots(1, 2)
    draw_albedo(reconstruction, figure, left)
    draw_depth(reconstruction, figure, right)
    below(figure, small_print(reconstruction), 7)
    warned(reconstruction, figure)
    return figure


@own_style()
def confidence_picture(reconstruction: Reconstruction, path: Path) -> None:
    """How well the wall was measured at each point, 0 to 1, as PNG. Raises `InvalidData` where that is not known."""
    if reconstruction.confidence is None:
        raise InvalidData(f"this {reconstruction.method} reconstruction does not say how well the wall was measured.")
    figure = Figure(figsize=(5.2, 4.6), layout="constrained")
    axes = figure.add_subplot()
    drawn = axes.imshow(
        reconstruction.confidence, cmap="gray", vmin=0, vmax=1, extent=extent(reconstruction), interpolation="nearest"
    )
    figure.colorbar(drawn, ax=axes, label="confidence (0 to 1)", shrink=0.85)
    _label(axes, "where the wall was measured")
    save_picture(figure, path)


def warned(reconstruction: Reconstruction, figure: Figure) -> None:
    """The label of a picture in which nothing is seen, that explains nothing, or of whose geometry there is doubt, in
    red above it."""
    told = reconstruction.explained
    unseen = not np.isfinite(visible_depth(reconstruction)).any()
    if unseen or (told is not None and (told.nothing or told.doubt)):
        words = UNSEEN if unseen else NOTHING if told is not None and told.nothing else MISPLACED
        figure.suptitle(words, color="white", backgroundcolor="firebrick", fontsize=11, weight="bold")


def _single(reconstruction: Reconstruction, path: Path, draw: Callable[[Reconstruction, Figure, Axes], None]) -> None:
    figure = Figure(figsize=(5.6, 4.9), layout="compressed")  # colour bars as high as a picture that is no square
    draw(reconstruction, figure, figure.add_subplot())
    below(figure, small_print(reconstruction), 6.5)
    warned(reconstruction, figure)
    save_picture(figure, path)


def _hatched(axes: Axes, reconstruction: Reconstruction) -> bool:
    """Hatches over what is drawn though there is more likely no surface than one; whether there is any such."""
    sure = reconstruction.intervals
    if sure is None:
        return False
    doubtful = (sure.seen < DOUBTFUL) & (reconstruction.albedo > FAINT * brightest(reconstruction))
    hatch(axes, doubtful, extent(reconstruction), "0.4")  # calm on what is dark and on what is bright
    return bool(doubtful.any())


def scale_bar(axes: Axes, width_m: float, height_m: float, colour: str, share: float = 0.26) -> None:
    """A bar of a round length, at most this share of a picture of the wall wide, in its lower right corner; the wall's
    centre is the origin."""
    length_m = max(step for step in (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10)
                   if step <= share * width_m or step == 0.001)  # fmt: skip
    right, bottom = 0.46 * width_m, -0.46 * height_m
    rim = [withStroke(linewidth=3.5, foreground="black")] if colour == "white" else []  # whatever bright lies below
    axes.plot([right - length_m, right], [bottom, bottom], color=colour, linewidth=2, solid_capstyle="butt",
              path_effects=rim)  # fmt: skip
    name = f"{length_m * 100:g} cm" if length_m < 1 else f"{length_m:g} m"
    axes.text(right - length_m / 2, bottom + 0.012 * height_m, name, color=colour, fontsize=7, ha="center",
              va="bottom", path_effects=rim)  # fmt: skip


def extent(reconstruction: Reconstruction) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of the wall in metres."""
    half_width, half_height = reconstruction.wall.width_m / 2, reconstruction.wall.height_m / 2
    return -half_width, half_width, -half_height, half_height


def _label(axes: Axes, title: str) -> None:
    axes.set(title=title, xlabel="x (m)", ylabel="y (m)")


def save_picture(figure: Figure, path: Path) -> None:
    """Writes a figure as PNG."""
    write_png(figure, path, DOTS_PER_INCH)
