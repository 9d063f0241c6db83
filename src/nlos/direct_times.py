"""When direct light arrives, by a whole scan: what its single frames, of far fewer photons, are aligned by."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData

if TYPE_CHECKING:
    from nlos.calibration.arrival_rounds import TimeOffsets
    from nlos.calibration.impulse_response import ImpulseResponse
    from nlos.calibration.known_direct import KnownDirect
    from nlos.calibration.raw_points import RawPoints
    from nlos.calibration.wall_timing import WallTiming


@dataclass(frozen=True, eq=False)
class DirectTimes:
    """Of every point of a scan, on its grid or at free positions."""

    offsets: "TimeOffsets"
    known: "KnownDirect"
    """Those of all points, and what comes with direct light."""
    places: Mapping[tuple[float, float], int] | None = None
    """Which of the offsets is that of a position (x, y) in metres; None on a grid, where they lie row by row."""

    @property
    def offset_bins(self) -> npt.NDArray[np.float64]:
        """In bins after the start of the record, (N,)."""
        return self.offsets.offset_bins

    @property
    def response(self) -> "ImpulseResponse":
        """What direct light looks like."""
        return self.offsets.response

    @property
    def wall(self) -> "WallTiming | None":
        """Wall, scanner and delay that explain them."""
        return self.offsets.wall

    def of(self, points: "RawPoints") -> "KnownDirect":
        """Those of some of the positions. Raises `InvalidData` for one that is not the scan's."""
        assert self.places is not None
        at = [self.places.get(place) for place in zip(points.x_m.tolist(), points.y_m.tolist(), strict=True)]
        if None in at:
            raise InvalidData(f"{points.name(at.index(None))} is none of the scan whose direct light is known.")
        return self.known.at(np.array(at, dtype=np.int64))
