"""Pictures of a reconstruction: front view, depth and slices, with axes in metres."""

from pathlib import Path

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nlos.recon.errors import InvalidData
from nlos.recon.volume import Reconstruction

DOTS_PER_INCH = 150
FAINT = 0.02  # of the brightest point; what the front view shows as black has no colour in a depth picture


def albedo_picture(reconstruction: Reconstruction, path: Path) -> None:
    """The front view, brightest at its 99.9th percentile, as PNG."""
    figure = Figure(figsize=(5.2, 4.6), layout="constrained")
    draw_albedo(reconstruction, figure, figure.add_subplot())
    _save(figure, path)


def draw_albedo(reconstruction: Reconstruction, figure: Figure, axes: Axes) -> None:
    """The front view with its colour bar."""
    drawn = axes.imshow(
        reconstruction.albedo / brightest(reconstruction),
        cmap="gray",
        vmin=0,
        vmax=1,
        extent=_extent(reconstruction),
        interpolation="nearest",
    )
    figure.colorbar(drawn, ax=axes, label="albedo (relative)", shrink=0.85)
    _label(axes, f"{reconstruction.method}: front view")


def depth_picture(reconstruction: Reconstruction, path: Path) -> None:
    """The depth map in metres, grey where nothing or next to nothing is seen, as PNG."""
    figure = Figure(figsize=(5.2, 4.6), layout="constrained")
    draw_depth(reconstruction, figure, figure.add_subplot())
    _save(figure, path)


def draw_depth(reconstruction: Reconstruction, figure: Figure, axes: Axes) -> None:
    """The depth map with its colour bar."""
    colours = matplotlib.colormaps["viridis_r"].with_extremes(bad="0.85")
    shown = visible_depth(reconstruction)
    seen = shown[np.isfinite(shown)]
    low, high = np.quantile(seen, [0.02, 0.98]) if seen.size else (0.0, 1.0)
    drawn = axes.imshow(
        np.ma.masked_invalid(shown), cmap=colours, vmin=low, vmax=max(high, low + 1e-3),
        extent=_extent(reconstruction), interpolation="nearest",
    )  # fmt: skip
    figure.colorbar(drawn, ax=axes, label="depth from the wall (m)", shrink=0.85)
    _label(axes, f"{reconstruction.method}: depth")


def summary_figure(reconstruction: Reconstruction, figure: Figure | None = None) -> Figure:
    """Front view and depth map side by side, on `figure` where one is given."""
    figure = figure or Figure()
    figure.set_size_inches(9.4, 4.2)
    figure.set_layout_engine("constrained")
    left, right = figure.subplots(1, 2)
    draw_albedo(reconstruction, figure, left)
    draw_depth(reconstruction, figure, right)
    return figure


def brightest(reconstruction: Reconstruction) -> float:
    """What is drawn as white: the 99.9th percentile of the front view."""
    return float(np.quantile(reconstruction.albedo, 0.999)) or 1.0


def visible_depth(reconstruction: Reconstruction) -> npt.NDArray[np.float32]:
    """depth_m (H, W) in metres without the points too faint to be told from black in the front view (NaN)."""
    bright = reconstruction.albedo >= FAINT * reconstruction.albedo.max(initial=0.0)
    return np.where(bright, reconstruction.depth_m, np.float32(np.nan))


def confidence_picture(reconstruction: Reconstruction, path: Path) -> None:
    """How well the wall was measured at each point, 0 to 1, as PNG. Raises `InvalidData` where that is not known."""
    if reconstruction.confidence is None:
        raise InvalidData(f"this {reconstruction.method} reconstruction does not say how well the wall was measured.")
    figure = Figure(figsize=(5.2, 4.6), layout="constrained")
    axes = figure.add_subplot()
    drawn = axes.imshow(
        reconstruction.confidence, cmap="gray", vmin=0, vmax=1, extent=_extent(reconstruction), interpolation="nearest"
    )
    figure.colorbar(drawn, ax=axes, label="confidence (0 to 1)", shrink=0.85)
    _label(axes, "where the wall was measured")
    _save(figure, path)


def slices_picture(reconstruction: Reconstruction, path: Path) -> None:
    """Three slices through the brightest voxel - from the front, from above, from the side - as PNG.

    Raises `InvalidData` where the reconstruction holds no volume.
    """
    volume = reconstruction.volume
    if volume is None:
        raise InvalidData(f"this {reconstruction.method} reconstruction holds no volume. Make it without --no-volume.")
    plane, row, col = (int(i) for i in np.unravel_index(int(volume.albedo.argmax()), volume.albedo.shape))
    left, right, bottom, top = _extent(reconstruction)
    near, far = float(volume.depths_m[0]), float(volume.depths_m[-1])
    x_m, y_m, z_m = volume.wall.x_m()[col], volume.wall.y_m()[row], volume.depths_m[plane]
    brightest = float(volume.albedo.max()) or 1.0
    figure = Figure(figsize=(11, 4), layout="constrained")
    views = (
        (volume.albedo[plane], (left, right, bottom, top), f"front, z = {z_m:.3f} m", "x (m)", "y (m)"),
        (volume.albedo[:, row], (left, right, far, near), f"from above, y = {y_m:.3f} m", "x (m)", "z (m)"),
        (volume.albedo[:, :, col].T, (near, far, bottom, top), f"from the side, x = {x_m:.3f} m", "z (m)", "y (m)"),
    )
    for axes, (image, extent, title, across, up) in zip(figure.subplots(1, 3), views, strict=True):
        axes.imshow(image / brightest, cmap="gray", vmin=0, vmax=1, extent=extent, interpolation="nearest")
        axes.set(title=title, xlabel=across, ylabel=up)
    _save(figure, path)


def _extent(reconstruction: Reconstruction) -> tuple[float, float, float, float]:
    half_width, half_height = reconstruction.wall.width_m / 2, reconstruction.wall.height_m / 2
    return -half_width, half_width, -half_height, half_height


def _label(axes: Axes, title: str) -> None:
    axes.set(title=title, xlabel="x (m)", ylabel="y (m)")


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=DOTS_PER_INCH, metadata={"Software": "nlos"})
