"""A scan in Python: counts, places and exposure as NumPy arrays, whatever file they came from."""

from functools import cached_property
from os import PathLike
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import Transient
from nlos.array_scan import Size, said_of_file, whether_rectified
from nlos.chain import arrivals_of, calibrate_scan, constants_for
from nlos.cli.escaped import escaped
from nlos.loaded import LoadedScan, load_scan
from nlos.python_words import said_in_python
from nlos.recon.own_arithmetic import own_arithmetic
from nlos.whole_imports import whole_imports

Floats = npt.NDArray[np.float64]


class Scan:
    """A scan before calibration: what was counted at which point of the wall, for how long.

    Row 0 is the top (y+), column 0 the left (x-), looking towards the wall. `nlos.reconstruct(scan)` calibrates it.
    """

    def __init__(self, loaded: LoadedScan, source: str, whole: LoadedScan | None = None) -> None:
        """`whole`: the scan that it is a frame of, by whose direct light it is aligned."""
        self.loaded, self.source, self.whole = loaded, source, whole

    @property
    def on_grid(self) -> bool:
        """Whether the points form a grid; otherwise each has a position of its own."""
        return self.loaded.points is None

    @cached_property
    def counts(self) -> npt.NDArray[np.generic]:
        """Photon counts, (H, W, T) on a grid or (N, T) at free positions."""
        points = self.loaded.points
        return np.moveaxis(self.loaded.transient.counts, 0, 2) if points is None else points.counts

    @property
    def exposure_s(self) -> Floats:
        """Live time in seconds, (H, W) or (N,); 0 = not measured."""
        points = self.loaded.points
        return self.loaded.transient.exposure_s if points is None else points.exposure_s

    @property
    def x_m(self) -> Floats:
        """Metres to the right of the wall's centre: of the columns (W,), or of every point (N,)."""
        points = self.loaded.points
        return self.loaded.transient.wall.x_m() if points is None else points.x_m

    @property
    def y_m(self) -> Floats:
        """Metres above the wall's centre: of the rows (H,), or of every point (N,)."""
        points = self.loaded.points
        return self.loaded.transient.wall.y_m() if points is None else points.y_m

    @property
    def bin_width_s(self) -> float:
        """Width of a time bin in seconds."""
        return self.loaded.transient.time.bin_width_s

    @property
    def wall_m(self) -> tuple[float, float]:
        """Width and height of the wall in metres."""
        wall = self.loaded.transient.wall
        return wall.width_m, wall.height_m

    @property
    def rectified(self) -> bool:
        """Whether time 0 is the wall and the direct light is gone already."""
        return self.loaded.rectified

    @property
    def falloff(self) -> int | None:
        """The light's falloff as the file states it: 4 diffuse, 2 retroreflective; None where it does not."""
        return self.loaded.falloff

    @said_in_python()
    @own_arithmetic()
    def calibrated(self, constants: str | Path | None = None) -> Transient:
        """The transient that methods see, counts (T, H, W): time 0 at the wall, direct light removed.

        `constants`: a file of `nlos calibrate`; else the newest of the scan's bench, else the scan's own direct light.
        """
        found = constants_for(self.loaded, None if constants is None else Path(constants))
        arrivals = None if self.whole is None else arrivals_of(self.whole, found)
        return calibrate_scan(self.loaded, constants=found, arrivals=arrivals)

    def __repr__(self) -> str:
        width_m, height_m = self.wall_m
        shape = " x ".join(str(n) for n in self.counts.shape[:-1])
        places = f"{shape} points" if self.on_grid else f"{shape} points at free positions"
        if (measured := int((self.exposure_s > 0).sum())) < self.exposure_s.size:
            places += f", {measured} measured"
        bins = f"{self.counts.shape[-1]} bins of {self.bin_width_s * 1e12:g} ps"
        photons = float(self.loaded.transient.counts.sum(dtype=np.float64))
        size = f"{width_m:g} x {height_m:g} m"
        kind = "rectified" if self.rectified else "raw"
        return f"<nlos.Scan {self.source}: {places}, {size}, {bins}, {photons:.4g} counts, {kind}>"

    def _repr_png_(self) -> bytes:
        from nlos.picture import png
        from nlos.report.scan_picture import scan_figure

        return png(scan_figure(self.loaded.transient))


@whole_imports()
@said_in_python()
@own_arithmetic()
def load(
    path: str | Path,
    frame: int | None = None,
    *,
    wall: Size | None = None,
    bin_width: float | None = None,
    axes: str | None = None,
    rectified: bool | np.bool_ | None = None,
    detector: int | None = None,
) -> Scan:
    """A scan from one of our recordings or any format of `nlos import`; of several frames all added up, or `frame`
    alone, aligned by the direct light of all.

    What a file does not say, or not rightly: `wall` its side or (width, height) in metres, `bin_width` in seconds,
    `axes` the order of its histograms' axes ("TYX"), `rectified` whether time 0 is the wall and direct light is gone;
    `detector`: photons of this one alone, by the file's own number for it.
    Raises `FileNotFoundError`, and `InvalidData` naming file, place and reason.
    """
    if not isinstance(path, str | PathLike):
        raise TypeError(
            f"the name of a file is expected (given: {type(path).__name__}). Of an array nlos.reconstruct makes a "
            "picture, told its wall and bin_width."
        )
    file, given = Path(path), said_of_file(wall, bin_width, axes, whether_rectified(rectified), detector)
    if frame is None:
        return Scan(load_scan(file, given), escaped(file.name))
    return Scan(load_scan(file, given, range(frame, frame + 1)), escaped(file.name), load_scan(file, given))
