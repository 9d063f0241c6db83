"""What an importer returns: a scan on a wall grid, as its file holds it, and what the file could not say."""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import Transient


@dataclass(frozen=True)
class ImportedScan:
    """A scan from another program. `transient` is as recorded: nothing cut, nothing shifted."""

    transient: Transient
    source_format: str
    direct_cut_bins: int = 0
    """The first bins that hold only direct light; 0 where the file says nothing."""
    falloff: int | None = None
    """4 diffuse, 2 retroreflective; None where the file says nothing."""
    rectified: bool = True
    """Whether time 0 is already the arrival at the wall point."""
    time_offset_bins: npt.NDArray[np.float64] | None = None  # (H, W)
    """Bin in which the rectified time 0 lies, where the file says so."""
    wall_known: bool = True
    """Whether the file says how large the wall is; where it does not, 1 m x 1 m stands in."""
    notes: tuple[str, ...] = field(default=())
    """What the file does not hold and was assumed, or holds and was left behind."""

    def on_wall(self, width_m: float, height_m: float) -> Self:
        """The same scan on a wall of that size, for files that do not store it."""
        wall = replace(self.transient.wall, width_m=width_m, height_m=height_m)
        return replace(self, transient=replace(self.transient, wall=wall), wall_known=True)
