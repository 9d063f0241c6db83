"""Results side by side on one scale: front views above depths, for a comparison, a report or a paper."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from nlos.recon.errors import InvalidData
from nlos.recon.own_style import own_style
from nlos.recon.pictures import BACKGROUND, OUTLINED
from nlos.recon.pixel_marks import hatch, outline
from nlos.recon.seen import brightest, depth_limits, depth_opacity, visible_depth
from nlos.recon.small_print import drawable
from nlos.recon.volume import Reconstruction

MM_PER_INCH = 25.4
MOST_COLUMNS = 6
HATCHED = ((-np.inf, -0.6, "white"), (-0.6, -0.1, "0.25"))
"""Differences from and below this part of the scale's end, and the colour that is seen on theirs."""


@own_style()
def gallery(results: Sequence[Reconstruction], titles: Sequence[str], width_mm: float = 178.0) -> Figure:
    """One column a result, `MOST_COLUMNS` to a line; every front view relative to its own brightest point, every depth
    by the same colours. Text of 7 points, as journals ask for. Raises `InvalidData` for no results."""
    if not results:
        raise InvalidData("a gallery of nothing: name at least one result")
    columns = min(len(results), MOST_COLUMNS)
    lines = -(-len(results) // columns)
    width = width_mm / MM_PER_INCH
    each = (width - 0.75) / columns
    with matplotlib.rc_context(
        {"font.size": 7, "axes.linewidth": 0.5, "xtick.major.width": 0.5, "ytick.major.width": 0.5}
    ):
        figure = Figure(figsize=(width, lines * (2 * each + 0.45) + 0.2), layout="compressed")
        panels = figure.subplots(2 * lines, columns, squeeze=False)
        scale, colours = Normalize(*depth_limits(results), clip=True), matplotlib.colormaps["viridis_r"]
        for panel in panels.flat:
            panel.set_axis_off()
        for number, (made, title) in enumerate(zip(results, titles, strict=True)):
            line, column = divmod(number, columns)
            first = results[line * columns]  # whose axis the others share, where their walls are alike
            x, y = made.wall.width_m / 2, made.wall.height_m / 2
            above, below = panels[2 * line, column], panels[2 * line + 1, column]
            above.imshow(made.albedo / brightest(made), cmap="gray", vmin=0, vmax=1, extent=(-x, x, -y, y))
            ink = depth_opacity(made)[..., None]
            colour = colours(scale(np.nan_to_num(visible_depth(made))))[..., :3]
            below.imshow(ink * colour + (1 - ink) * BACKGROUND, extent=(-x, x, -y, y))
            outline(below, ink[..., 0] >= OUTLINED, (-x, x, -y, y))
            above.set_title(drawable(title), fontsize=7, parse_math=False)
            for panel in (above, below):
                panel.set_axis_on()
                panel.tick_params(
                    length=2, labelleft=column == 0 or made.wall != first.wall, labelbottom=panel is below
                )
            if column == 0:
                above.set_ylabel("y (m)")
                below.set_ylabel("y (m)")
            below.set_xlabel("x (m)")
        grey = ScalarMappable(Normalize(0, 1), "gray")
        figure.colorbar(grey, ax=panels[0::2].ravel().tolist(), label="brightness (relative)", aspect=30, pad=0.01)
        bar = ScalarMappable(scale, colours)
        figure.colorbar(bar, ax=panels[1::2].ravel().tolist(), label="depth from the wall (m)", aspect=30, pad=0.01)
        for _ in range(3):  # no more paper than is drawn on, whose layout depends on how much there is
            figure.draw_without_rendering()
            figure.set_size_inches(width, figure.get_tightbbox().height + 0.1)
    return figure


@own_style()
def save_gallery(figure: Figure, path: Path, kind: str) -> None:
    """Writes a gallery as `kind`: png of 300 dots per inch; pdf with TrueType fonts inside, which journals ask for; svg
    with letters as outlines, which look the same where the font is missing. Raises `OSError` where the disk does not
    take it."""
    drawn = io.BytesIO()  # of a full disk matplotlib's own writer of pdf tells as of an error in itself
    with matplotlib.rc_context({"pdf.fonttype": 42, "svg.fonttype": "path"}):
        figure.savefig(drawn, dpi=300, format=kind)
    path.write_bytes(drawn.getbuffer())


@own_style()
def difference_figure(one: Reconstruction, other: Reconstruction, titles: tuple[str, str]) -> Figure:
    """Front view and depth of one less the other's, where both have them, on the finer grid of both. Raises
    `InvalidData` for walls of other sizes."""
    if (one.wall.width_m, one.wall.height_m) != (other.wall.width_m, other.wall.height_m):
        raise InvalidData(
            f"{titles[0]} and {titles[1]} are of walls of different sizes: there is no difference to draw"
        )
    rows, cols = (max(sizes) for sizes in zip(one.albedo.shape, other.albedo.shape, strict=True))
    figure = Figure(figsize=(9.4, 4.2), layout="constrained")
    x, y = one.wall.width_m / 2, one.wall.height_m / 2
    bright = _on_grid(one.albedo / brightest(one), rows, cols) - _on_grid(other.albedo / brightest(other), rows, cols)
    deep_mm = (_on_grid(visible_depth(one), rows, cols) - _on_grid(visible_depth(other), rows, cols)) * 1e3
    reach_mm = max(float(np.nanquantile(np.abs(deep_mm), 0.98)) if np.isfinite(deep_mm).any() else 1.0, 1.0)
    drawn = ((bright, 1.0, "front view (relative)"), (deep_mm, reach_mm, "depth (mm)"))
    for panel, (values, reach, label) in zip(figure.subplots(1, 2), drawn, strict=True):
        panel.set_facecolor(str(BACKGROUND))
        image = panel.imshow(values, cmap="RdBu_r", vmin=-reach, vmax=reach, extent=(-x, x, -y, y))
        bar = figure.colorbar(image, ax=panel, label=f"{label}, hatched: below zero", shrink=0.85, extend="both")
        for low, high, ink in HATCHED:  # to who sees no colours, both ends are as dark
            hatch(panel, (values < high * reach) & (values >= low * reach), (-x, x, -y, y), ink)
            bar.ax.fill_between([0, 1], max(low, -1) * reach, high * reach, facecolor="none", edgecolor=ink,
                                hatch="///", linewidth=0)  # fmt: skip
        panel.set(xlabel="x (m)", ylabel="y (m)")
        panel.set_title(drawable(f"{titles[0]} less {titles[1]}"), parse_math=False)
    return figure


def _on_grid(values: npt.NDArray[np.floating[Any]], rows: int, cols: int) -> npt.NDArray[np.floating[Any]]:
    """Every pixel of a finer grid takes the value that lies at its centre."""
    row = ((np.arange(rows) + 0.5) * values.shape[0] / rows).astype(np.intp)
    col = ((np.arange(cols) + 0.5) * values.shape[1] / cols).astype(np.intp)
    return values[np.ix_(row, col)]
