"""What an importer returns: a scan on a grid or at free positions as its file holds it, and what it did not say."""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.response import Response
from nlos.acquisition.transient import MOST_COUNTS, TimeAxis, Transient
from nlos.acquisition.wall import WallGrid, grid_around

LARGEST_WALL_M = 100.0
MOST_POINTS = 4096 * 4096
NARROWEST_BIN_S, WIDEST_BIN_S = 1e-13, 1e-6
LONGEST_EXPOSURE_S = 1e7

ALL_NAN = "points hold NaN alone"
"""What a note says of points that were not measured."""

NO_WALL = "the wall's size is not stored"
"""How a note begins that says what was assumed of it."""

SUBTRACTED = (
    " Was background subtracted? Store what was counted. Where that is lost, add one number to all histograms, so that "
    "none is below 0: that counts as ambient light. 0 in place of what is negative leaves half of the noise."
)
"""What to do about a count below 0."""

DOUBT = "in doubt:"
"""How a note begins that is a warning."""

ASSUMED = "points as far apart in x as in y, 1 m over the longer side"


def assumed_sides_m(rows: int, cols: int, longer_m: float = 1.0) -> tuple[float, float]:
    """Width and height of a wall of which only the points are known: as far apart in x as in y."""
    pitch_m = longer_m / max(rows, cols)
    return cols * pitch_m, rows * pitch_m


PLAIN_FIELDS = (
    "source_format",
    "direct_cut_bins",
    "falloff",
    "rectified",
    "rectified_assumed",
    "wall_known",
    "no_direct_light",
)
"""Fields of a scan that are single values."""


@dataclass(frozen=True)
class FreePoints:
    """N histograms at positions of their own on the wall; `wall` is the grid that they are to be put on."""

    counts: npt.NDArray[np.float32]  # (N, T)
    exposure_s: npt.NDArray[np.float64]  # (N,)
    x_m: npt.NDArray[np.float64]  # (N,)
    y_m: npt.NDArray[np.float64]  # (N,)
    wall: WallGrid
    time: TimeAxis


@dataclass(frozen=True)
class ImportedScan:
    """A scan from another program, as recorded: nothing cut, nothing shifted."""

    held: Transient | FreePoints
    source_format: str
    direct_cut_bins: int = 0
    """The first bins that hold only direct light; 0 where the file says nothing."""
    falloff: int | None = None
    """4 diffuse, 2 retroreflective; None where the file says nothing."""
    rectified: bool = True
    """Whether time 0 is already the arrival at the wall point."""
    rectified_assumed: bool = False
    """Whether neither the file nor the user has said so."""
    time_offset_bins: npt.NDArray[np.float64] | None = None  # (H, W)
    """Bin in which the rectified time 0 lies, where the file says so."""
    no_direct_light: bool = False
    """Whether the record lacks direct light, so that only `time_offset_bins` say when light reaches the wall."""
    wall_known: bool = True
    """Whether the file says how large the wall is; where it does not, `assumed_sides_m` is."""
    response: Response | None = None
    """What the instrument makes of an instant of light, where the file says so."""
    notes: tuple[str, ...] = field(default=())
    """What the file does not hold and was assumed, or holds and was not imported."""

    @property
    def transient(self) -> Transient:
        """The scan on its grid. Raises `InvalidData` for free positions."""
        if isinstance(self.held, FreePoints):
            raise InvalidData("its points are off the grid")
        return self.held

    @property
    def points(self) -> FreePoints | None:
        """The scan at free positions; None where it lies on a grid."""
        return self.held if isinstance(self.held, FreePoints) else None

    def on_wall(self, width_m: float, height_m: float) -> Self:
        """The same scan on a wall of that size, for files that do not store it. Free positions keep their places."""
        if isinstance(self.held, FreePoints):
            wall = grid_around(self.held.x_m, self.held.y_m, (width_m, height_m))
        else:
            wall = replace(self.held.wall, width_m=width_m, height_m=height_m)
        return replace(self, held=replace(self.held, wall=wall), wall_known=True)

    def check(self, name: str) -> None:
        """Raises `InvalidData`, naming file `name` and place, for what nobody can have measured."""
        held, time, wall = self.held, self.held.time, self.held.wall
        if not (0 < wall.width_m <= LARGEST_WALL_M and 0 < wall.height_m <= LARGEST_WALL_M):
            raise InvalidData(f"{name}: the wall is {wall.width_m:g} x {wall.height_m:g} m; expected at most 100 m")
        if not NARROWEST_BIN_S <= time.bin_width_s <= WIDEST_BIN_S:
            raise InvalidData(f"{name}: the bin width is {time.bin_width_s:g} s; expected 1e-13 to 1e-6 s")
        if not 0 <= time.start_s <= 1:
            raise InvalidData(f"{name}: its time axis begins at {time.start_s:g} s; expected 0 to 1 s")
        if held.exposure_s.size > MOST_POINTS or not 0 <= self.direct_cut_bins < time.bins:
            raise InvalidData(f"{name}: {held.exposure_s.size} points, {self.direct_cut_bins} bins of direct light")
        for place, values in (("exposure_s", held.exposure_s), ("time_offset_bins", self.time_offset_bins)):
            if values is not None and not np.isfinite(values).all():
                raise InvalidData(f"{name}: {place}: holds values that are not finite")
        if not held.exposure_s.any():
            why = next((f": {note}" for note in self.notes if ALL_NAN in note), ": exposure_s is 0 everywhere")
            raise InvalidData(f"{name}: no point of it was measured{why}")
        if not 0 < held.exposure_s.max() <= LONGEST_EXPOSURE_S or held.exposure_s.min() < 0:
            raise InvalidData(f"{name}: exposure_s: from {held.exposure_s.min():g} to {held.exposure_s.max():g} s")
        if isinstance(held, FreePoints) and not (np.isfinite(held.x_m).all() and np.isfinite(held.y_m).all()):
            raise InvalidData(f"{name}: x_m, y_m: hold positions that are not finite")
        for bad, what in (
            (~np.isfinite(held.counts), "not a number"),
            (held.counts < 0, "negative"),
            (held.counts > MOST_COUNTS, f"more than anybody counts, {MOST_COUNTS:.2g}"),
        ):
            if bad.any():
                place = _place(held, np.argwhere(bad)[0].tolist())
                value = held.counts[tuple(np.argwhere(bad)[0])]
                told = SUBTRACTED if what == "negative" else ""
                raise InvalidData(
                    f"{name}: histograms: {place} is {what} ({value:g}).{told} Fix that point, or give it exposure 0."
                )


def _place(held: Transient | FreePoints, index: list[int]) -> str:
    if isinstance(held, FreePoints):
        return f"point {index[0]}, bin {index[1]}"
    return f"row {index[1]}, column {index[2]}, bin {index[0]}"
