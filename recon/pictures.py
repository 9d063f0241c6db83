"""Pictures of a reconstruction: front view, depth and slices, with axes in metres."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from recon.volume import Reconstruction

DOTS_PER_INCH = 150


def albedo_picture(reconstruction: Reconstruction, path: Path) -> None:
    """The front view, brightest at its 99.9th percentile, as PNG."""
    figure = Figure(figsize=(5.2, 4.6), layout="constrained")
    axes = figure.add_subplot()
    top = float(np.quantile(reconstruction.albedo, 0.999)) or 1.0
    drawn = axes.imshow(
        reconstruction.albedo / top,
        cmap="gray",
        vmin=0,
        vmax=1,
        extent=_extent(reconstruction),
        interpolation="nearest",
    )
    figure.colorbar(drawn, ax=axes, label="albedo (relative)", shrink=0.85)
    _label(axes, f"{reconstruction.method}: front view")
    _save(figure, path)


def depth_picture(reconstruction: Reconstruction, path: Path) -> None:
    """The depth map in metres, grey where nothing is seen, as PNG."""
    figure = Figure(figsize=(5.2, 4.6), layout="constrained")
    axes = figure.add_subplot()
    colours = matplotlib.colormaps["viridis_r"].with_extremes(bad="0.85")
    seen = reconstruction.depth_m[np.isfinite(reconstruction.depth_m)]
    low, high = np.quantile(seen, [0.02, 0.98]) if seen.size else (0.0, 1.0)
    drawn = axes.imshow(
        np.ma.masked_invalid(reconstruction.depth_m), cmap=colours, vmin=low, vmax=max(high, low + 1e-3),
        extent=_extent(reconstruction), interpolation="nearest",
    )  # fmt: skip
    figure.colorbar(drawn, ax=axes, label="depth from the wall (m)", shrink=0.85)
    _label(axes, f"{reconstruction.method}: depth")
    _save(figure, path)


def _extent(reconstruction: Reconstruction) -> tuple[float, float, float, float]:
    half_width, half_height = reconstruction.wall.width_m / 2, reconstruction.wall.height_m / 2
    return -half_width, half_width, -half_height, half_height


def _label(axes: Axes, title: str) -> None:
    axes.set(title=title, xlabel="x (m)", ylabel="y (m)")


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=DOTS_PER_INCH, metadata={"Software": "nlos"})
