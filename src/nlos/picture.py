"""What a reconstruction gives back in Python: arrays, a picture in a notebook, files on request."""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from nlos.python_words import said_in_python
from nlos.recon.own_style import own_style
from nlos.recon.pictures import summary_figure
from nlos.recon.png import write_png
from nlos.recon.results import write_results
from nlos.recon.volume import Reconstruction, response_words
from nlos.writable import check_writable

if TYPE_CHECKING:
    import xarray

Floats = npt.NDArray[np.float64]


class Picture:
    """Front view and depth map of what is behind the corner, and the volume where the method has one.

    Row 0 is the top (y+), column 0 the left (x-), looking towards the wall.
    """

    def __init__(self, reconstruction: Reconstruction) -> None:
        self.reconstruction = reconstruction

    @property
    def albedo(self) -> npt.NDArray[np.float32]:
        """Brightness (H, W), in arbitrary units."""
        return self.reconstruction.albedo

    @property
    def depth_m(self) -> npt.NDArray[np.float32]:
        """Distance from the wall in metres (H, W); NaN where nothing is seen."""
        return self.reconstruction.depth_m

    @property
    def volume(self) -> npt.NDArray[np.float32] | None:
        """Albedo (D, H, W) at the depths `depths_m`; None for a method without one."""
        volume = self.reconstruction.volume
        return None if volume is None else volume.albedo

    @property
    def depths_m(self) -> Floats | None:
        """Depth of every plane of the volume in metres (D,)."""
        volume = self.reconstruction.volume
        return None if volume is None else volume.depths_m

    @property
    def x_m(self) -> Floats:
        """Columns, metres to the right of the wall's centre (W,)."""
        return self.reconstruction.wall.x_m()

    @property
    def y_m(self) -> Floats:
        """Rows, metres above the wall's centre (H,)."""
        return self.reconstruction.wall.y_m()

    @property
    def response(self) -> str:
        """The instrument's response that was taken, and where it is from."""
        return response_words(self.reconstruction)

    @property
    def method(self) -> str:
        """The method's name in `nlos.methods()`."""
        return self.reconstruction.method

    @property
    def settings(self) -> dict[str, Any]:
        """The settings it ran with, defaults included."""
        return dict(self.reconstruction.settings)

    @property
    def seconds(self) -> float:
        """How long the reconstruction took."""
        return self.reconstruction.seconds

    @property
    def explained(self) -> float | None:
        """The share of light that it was not made from which the picture accounts for: 1 is all of it, 0 none; None
        where that could not be found."""
        told = self.reconstruction.explained
        return None if told is None else told.share

    @property
    def explained_error(self) -> float | None:
        """The standard error of `explained`."""
        told = self.reconstruction.explained
        return None if told is None else told.error

    @property
    def doubt(self) -> str:
        """What speaks against the scan's wall, time zero or order of points, in words; empty where nothing does."""
        told = self.reconstruction.explained
        return "" if told is None else told.doubt

    def figure(self) -> Figure:
        """Front view and depth map side by side, axes in metres."""
        return summary_figure(self.reconstruction)

    def show(self) -> None:
        """Shows the figure: in the notebook's cell, or in a window where there is a display."""
        import matplotlib.pyplot as plt

        with own_style():
            figure = plt.figure(FigureClass=Figure)
            summary_figure(self.reconstruction, figure).draw_without_rendering()  # ticks, too, are made as they look
        plt.show()

    @said_in_python()
    def save(self, folder: str | Path, *, overwrite: bool = False) -> list[Path]:
        """Writes reconstruction.h5, albedo.png, depth.png and slices.png; returns the paths.

        Raises `FileExistsError` unless `overwrite`, before anything is written, also where `folder` is a file, and
        `PermissionError` where nothing can be written.
        """
        check_writable(Path(folder))
        return write_results(Path(folder), self.reconstruction, overwrite=overwrite)

    def to_xarray(self) -> "xarray.Dataset":
        """The arrays with named axes (z, y, x) in metres. Needs the package xarray."""
        try:
            import xarray
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "to_xarray needs the package xarray: pip install xarray", name="xarray"
            ) from error

        made = self.reconstruction
        data: dict[str, Any] = {
            "albedo": (("y", "x"), made.albedo),
            "depth": (("y", "x"), made.depth_m, {"units": "m"}),
        }
        coordinates: dict[str, Any] = {"y": ("y", self.y_m, {"units": "m"}), "x": ("x", self.x_m, {"units": "m"})}
        if made.volume is not None:
            data["volume"] = (("z", "y", "x"), made.volume.albedo)
            coordinates["z"] = ("z", made.volume.depths_m, {"units": "m"})
        return xarray.Dataset(data, coordinates, {"method": made.method, "seconds": made.seconds})

    def __repr__(self) -> str:
        rows, cols = self.albedo.shape
        depths, middle = "nothing seen", self.reconstruction.middle_depths_m()
        if middle is not None:
            depths = f"surfaces from {middle[0]:.2f} to {middle[1]:.2f} m"
        told = self.reconstruction.explained
        light = f", {told}" if told is not None and told.share is not None else ""
        return f"<nlos.Picture by {self.method}: {rows} x {cols}, {depths}{light}, {self.seconds:.2f} s>"

    def _repr_png_(self) -> bytes:
        return png(self.figure())


def png(figure: Figure) -> bytes:
    """A figure as PNG."""
    stream = BytesIO()
    write_png(figure, stream, 110)
    return stream.getvalue()
