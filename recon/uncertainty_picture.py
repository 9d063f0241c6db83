"""uncertainty.png: whether there is a surface, and how wide the 90 % intervals of brightness and depth are."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from nlos.recon.errors import InvalidData
from nlos.recon.own_style import own_style
from nlos.recon.pictures import BACKGROUND, extent, save_picture
from nlos.recon.pixel_marks import outline
from nlos.recon.seen import brightest
from nlos.recon.small_print import below, small_print
from nlos.recon.volume import Reconstruction

NARROWEST_M, WIDEST_M = 0.002, 0.5
TICKS_CM = (0.2, 0.5, 1, 2, 5, 10, 20, 50)
LIKELY, MOST = 0.5, 0.98
"""The scale of brightness is made for this share of the pixels where there is as likely a surface as this."""
SHRUNK = 0.75  # a colour bar to the height of its picture
TITLE_POINTS = 10
"""As wide as a panel; larger, a title runs into the colour bar beside it."""


@own_style()
def uncertainty_picture(reconstruction: Reconstruction, path: Path) -> None:
    """Writes the PNG. Raises `InvalidData` where the method does not know how sure it is."""
    if reconstruction.intervals is None:
        raise InvalidData(f"this {reconstruction.method} reconstruction does not say how sure it is.")
    figure = Figure(figsize=(12.4, 4.2), layout="constrained")
    draw_uncertainty(reconstruction, figure)
    said = "outlined: likely a surface; pale outside: hardly one. An interval holds the truth in nine cases of ten."
    below(figure, f"{said}\n{small_print(reconstruction)}", 6.5)
    save_picture(figure, path)


def draw_uncertainty(reconstruction: Reconstruction, figure: Figure) -> None:
    """Three panels; widths fade where there is hardly a surface."""
    sure = reconstruction.intervals
    assert sure is not None
    left, middle, right = figure.subplots(1, 3)
    shown = left.imshow(sure.seen, cmap="gray", vmin=0, vmax=1, extent=extent(reconstruction), interpolation="nearest")
    figure.colorbar(shown, ax=left, label="probability of a surface", shrink=SHRUNK)
    left.set(xlabel="x (m)", ylabel="y (m)")
    left.set_title("is there a surface?", fontsize=TITLE_POINTS)
    wide = (sure.albedo_high - sure.albedo_low) / brightest(reconstruction)
    widest = _widest(wide, sure.seen)
    name = "1: as wide as the brightest point is bright"
    _faded(middle, figure, reconstruction, wide, Normalize(0, widest, clip=True), name)
    middle.set_title("brightness: width of its 90 % interval", fontsize=TITLE_POINTS)
    deep = np.clip(sure.depth_high_m - sure.depth_low_m, NARROWEST_M, WIDEST_M) * 100
    _faded(right, figure, reconstruction, deep, LogNorm(NARROWEST_M * 100, WIDEST_M * 100, clip=True), "cm")
    right.set_title("depth: width of its 90 % interval", fontsize=TITLE_POINTS)


def _widest(wide: np.ndarray, seen: np.ndarray) -> float:
    """The end of a scale on which widths can be read where there is a surface: a round number that hardly one of them
    exceeds. Intervals are as wide as the brightest point is bright, and wider, where light is dim."""
    there = wide[seen >= min(LIKELY, 0.5 * float(seen.max()))]
    reached = max(float(np.quantile(there, MOST)), 1e-3)
    step = 10.0 ** np.floor(np.log10(reached))
    return float(next(step * each for each in (1, 2, 3, 5, 10) if step * each >= 0.999 * reached))


def _faded(
    axes: Axes, figure: Figure, reconstruction: Reconstruction, values: np.ndarray, scale: Normalize, name: str
) -> None:
    assert reconstruction.intervals is not None
    colours = matplotlib.colormaps["magma_r"]
    ink = reconstruction.intervals.seen[..., None]
    colour = colours(scale(values))[..., :3]
    axes.imshow(ink * colour + (1 - ink) * BACKGROUND, extent=extent(reconstruction), interpolation="nearest")
    outline(axes, reconstruction.intervals.seen >= LIKELY, extent(reconstruction))  # without colours sure is pale, too
    axes.set(xlabel="x (m)", ylabel="y (m)")
    beyond = "max" if (values > scale.vmax).any() else "neither"
    bar = figure.colorbar(ScalarMappable(scale, colours), ax=axes, label=name, shrink=SHRUNK, extend=beyond)
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:g}"))
    if isinstance(scale, LogNorm):
        bar.set_ticks(TICKS_CM)
