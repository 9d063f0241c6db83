"""When direct light arrives at the points of the wall, and how long it hides the scene: how a histogram is read."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from nlos.calibration.constants import BenchConstants
    from nlos.calibration.correct import CorrectedPoints
    from nlos.loaded import LoadedScan

Floats = npt.NDArray[np.float64]
SAME_M = 1e-6
"""Points closer together than this are one."""


@dataclass(frozen=True)
class TimeZero:
    """Direct arrivals as a picture has them: at points that it was made of, and between them by the wall's fit."""

    x_m: Floats  # (N,)
    y_m: Floats  # (N,)
    arrival_s: Floats  # (N,), on the record's time axis; NaN where there is none
    masked_s: float
    """How long after its arrival direct light hides the scene; later bins make the picture."""

    @classmethod
    def of(cls, scan: "LoadedScan", found: "CorrectedPoints | None", constants: "BenchConstants | None") -> "TimeZero":
        """Of a calibrated scan; `found` is None where nothing had to be aligned: time 0 is the wall's."""
        time = scan.transient.time
        x_m, y_m = _places(scan)
        if found is None:
            return cls(x_m, y_m, np.zeros(len(x_m)), (scan.direct_cut_bins or 0) * time.bin_width_s)
        masked_s = found.direct.end_bin * time.bin_width_s
        if found.offsets is not None:
            return cls(x_m, y_m, time.start_s + found.offsets.offset_bins * time.bin_width_s, masked_s)
        assert constants is not None
        return cls(x_m, y_m, _known_s(constants, x_m, y_m), masked_s)

    @classmethod
    def known(cls, constants: "BenchConstants", x_m: Floats, y_m: Floats) -> "TimeZero":
        """By constants alone."""
        return cls(x_m, y_m, _known_s(constants, x_m, y_m), constants.direct_end_bin * constants.bin_width_s)

    def at(self, x_m: float, y_m: float) -> float | None:
        """The arrival at one of the points, in seconds; None where it is not known."""
        away_m = np.hypot(self.x_m - x_m, self.y_m - y_m)
        nearest = int(np.argmin(away_m)) if len(away_m) else -1
        if nearest < 0 or away_m[nearest] > SAME_M or not np.isfinite(self.arrival_s[nearest]):
            return None
        return float(self.arrival_s[nearest])


def _places(scan: "LoadedScan") -> tuple[Floats, Floats]:
    if scan.points is not None:
        return scan.points.x_m, scan.points.y_m
    wall = scan.transient.wall
    x_m, y_m = (grid.reshape(-1) for grid in np.meshgrid(wall.x_m(), wall.y_m()))
    return x_m, y_m


def _known_s(constants: "BenchConstants", x_m: Floats, y_m: Floats) -> Floats:
    return np.asarray(np.nan if constants.arrivals is None else constants.arrivals.at(x_m, y_m)) + np.zeros(len(x_m))
