"""Widths of intervals can be read off the drawn colours, whether they are a tenth of the brightest point or five times
as wide as it is bright."""

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from nlos.acquisition.wall import WallGrid
from nlos.recon.uncertainty_picture import draw_uncertainty
from nlos.recon.volume import Intervals, Reconstruction


@pytest.mark.parametrize("largest", [0.04, 0.3, 1.0, 4.6])
def test_brightness_widths_are_read_back_from_their_colours(largest: float) -> None:
    wall = WallGrid(1.0, 1.0, 16, 16)
    albedo = np.ones(wall_shape := (16, 16), np.float32)
    widths = np.linspace(0.2, 1.0, 256).reshape(wall_shape).astype(np.float32) * np.float32(largest)
    depth_m = np.full(wall_shape, 0.8, np.float32)
    sure = Intervals(albedo * 0, widths, depth_m - 0.01, depth_m + 0.01, np.ones(wall_shape, np.float32))
    figure = Figure()
    draw_uncertainty(Reconstruction(albedo, depth_m, wall, "nano", 0.0, {}, None, intervals=sure), figure)
    middle = next(axes for axes in figure.axes if axes.get_title().startswith("brightness"))
    drawn = np.asarray(middle.images[0].get_array())[..., :3].reshape(-1, 1, 3)
    bar = next(axes for axes in figure.axes if "brightest point" in axes.get_ylabel())
    low, high = bar.get_ylim()
    colours = matplotlib.colormaps["magma_r"](np.linspace(0, 1, 256))[None, :, :3]
    read = low + (high - low) * np.abs(drawn - colours).sum(axis=2).argmin(axis=1) / 255
    assert np.abs(read - widths.ravel()).max() < 0.07 * largest
    assert high < 3 * largest


def test_what_is_sure_is_told_from_what_is_hardly_there_without_colours() -> None:
    """Both are pale: a line goes around what is likely a surface."""
    wall, ones = WallGrid(1.0, 1.0, 16, 16), np.ones((16, 16), np.float32)
    seen = np.where(np.arange(16) < 8, np.float32(0.9), np.float32(0.1)) * ones
    figure = Figure()
    sure = Intervals(ones * 0.99, ones, ones * 0.8, ones * 0.801, seen)
    draw_uncertainty(Reconstruction(ones, ones * 0.8, wall, "nano", 0.0, {}, None, intervals=sure), figure)
    for panel in figure.axes[1:3]:
        (line,) = panel.patches
        corners = line.get_path().vertices
        assert np.ptp(corners, axis=0) == pytest.approx([0.5, 1.0])
        assert corners[:, 0].max() == pytest.approx(0.0)
