"""Raw histograms of a file that knows neither the wall nor when light arrived there, as a scan."""

from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import ASSUMED, NO_WALL, ImportedScan, assumed_sides_m
from nlos.acquisition.transient import TimeAxis, Transient, as_floats
from nlos.acquisition.wall import WallGrid


def raw_scan(
    counts: npt.NDArray[Any],
    exposure_s: npt.NDArray[np.float64],
    bin_width_s: float,
    name: str,
    notes: tuple[str, ...],
    where: str,
) -> ImportedScan:
    """Histograms (H, W, T) with exposures (H, W) on a wall of unknown size. Raises `InvalidData`, naming the file
    `where`, for a bin width that no instrument has."""
    rows, cols, bins = counts.shape
    if not 1e-13 <= bin_width_s <= 1e-6:
        raise InvalidData(f"{where}: states a bin width of {bin_width_s:g} s; expected 1e-13 to 1e-6 s")
    transient = Transient(
        as_floats(np.moveaxis(counts, 2, 0)),
        exposure_s,
        WallGrid(*assumed_sides_m(rows, cols), rows, cols),
        TimeAxis(bins, bin_width_s),
    )
    return ImportedScan(
        transient, name, rectified=False, wall_known=False, notes=(f"{NO_WALL}; assuming {ASSUMED}", *notes)
    )
