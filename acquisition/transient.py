"""A time axis, and the transient that every reconstruction starts from: counts over time and wall."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.response import Response
from nlos.acquisition.wall import WallGrid

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0
MOST_COUNTS = 2.0**53
"""In a bin: up to there numbers of any kind are exact, and nobody waits for as many photons."""
EXACT = 2.0**24
"""Whole numbers up to there are exact in 32 bits."""


def as_floats(counts: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Counts as contiguous floats: of 32 bits, or of 64 where those would round them."""
    with np.errstate(over="ignore"):  # what is beyond them all is refused later
        narrow = np.ascontiguousarray(counts, dtype=np.float32)
    rounded = float(narrow.max(initial=0)) >= EXACT and not np.array_equal(narrow, counts, equal_nan=True)
    return np.ascontiguousarray(counts, dtype=np.float64) if rounded else narrow


@dataclass(frozen=True)
class TimeAxis:
    """`bins` of `bin_width_s`; bin k covers [start_s + k w, start_s + (k + 1) w).

    In a `Transient`, time 0 is the arrival of light scattered directly at the wall point.
    """

    bins: int
    bin_width_s: float
    start_s: float = 0.0

    def __post_init__(self) -> None:
        if self.bins < 1:
            raise ValueError(f"time axis has {self.bins} bins; at least 1 is needed")
        if not self.bin_width_s > 0:
            raise ValueError(f"bin width is {self.bin_width_s:g} s; it must be above 0")

    def centres_s(self) -> npt.NDArray[np.float64]:
        """Centre of each bin, shape (T,)."""
        return np.asarray(self.start_s + (np.arange(self.bins) + 0.5) * self.bin_width_s, dtype=np.float64)


@dataclass(frozen=True)
class Transient:
    """Counts on the wall grid, how long each point was exposed (0 = not measured), and both axes.

    `counts` holds counts (after calibration: corrected counts, possibly fractional), not rates.
    """

    counts: npt.NDArray[np.float32]  # (T, H, W)
    exposure_s: npt.NDArray[np.float64]  # (H, W)
    wall: WallGrid
    time: TimeAxis
    response: Response | None = None
    """What the instrument makes of an instant of light; None where nobody knows."""

    def __post_init__(self) -> None:
        expected = (self.time.bins, self.wall.rows, self.wall.cols)
        if self.counts.shape != expected:
            raise ValueError(f"counts have shape {self.counts.shape}, but time axis and wall say {expected}")
        if self.exposure_s.shape != expected[1:]:
            raise ValueError(f"exposure_s has shape {self.exposure_s.shape}, but the wall says {expected[1:]}")
