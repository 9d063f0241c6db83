"""Samples corrected one by one as they come, where the bench's constants are known: what pictures in passing show."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from nlos.acquisition.planning.exposure import unbiased_live_s
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.calibration.errors import CalibrationError, NoDirectPeak
from nlos.calibration.known_arrivals import common_bins
from nlos.calibration.one_sample import correct_sample
from nlos.calibration.wall_brightness import HiddenLight, doubt_wall_brightness, wall_brightness
from nlos.live.time_zero import TimeZero
from nlos.response import response_of

if TYPE_CHECKING:
    import numpy.typing as npt

    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.sample import Sample
    from nlos.calibration.constants import BenchConstants


class SampleCalibration:
    """Sums of samples, each corrected by `constants` alone the moment it comes: no sample waits for another, and no
    picture for enough direct light to measure by. The finished recording is calibrated as a whole (`calibrate_scan`).
    """

    def __init__(self, plan: "ScanPlan", constants: "BenchConstants") -> None:
        """Raises `InvalidData` where the constants hold no arrivals, or are for other bins."""
        axis, wall = plan.axis, plan.wall
        time = TimeAxis(axis.bins, axis.bin_width_s, axis.offset_s)
        self._plan, self._constants = plan, constants
        self._bins = common_bins(constants, plan.positions.x_m, plan.positions.y_m, time)
        self._counts = np.zeros((wall.rows, wall.cols, self._bins), dtype=np.float32)
        self._variance, self._usable = np.zeros_like(self._counts), np.ones(self._bins, dtype=bool)
        self._exposure_s, self._direct = np.zeros((2, wall.rows, wall.cols))
        self._time = TimeAxis(self._bins, axis.bin_width_s)
        self._response = response_of(constants)
        self.zero = TimeZero.known(constants, plan.positions.x_m, plan.positions.y_m)
        """When direct light arrives."""

    @classmethod
    def where_known(
        cls, plan: "ScanPlan", constants: "BenchConstants | None", say: Callable[[str], None]
    ) -> "SampleCalibration | None":
        """None without constants, and where they do not do for this plan, which is said."""
        if constants is None:
            return None
        try:
            return cls(plan, constants)
        except CalibrationError as error:
            say(f"samples are not corrected one by one: {error}")
            return None

    def add(self, sample: "Sample") -> None:
        """Corrects one sample of the plan and adds it; a point off the record of the histogram stays unmeasured."""
        point, histogram = sample.point, sample.histogram
        try:
            done = correct_sample(sample, self._constants, self._bins)
        except NoDirectPeak:
            return
        live_s = unbiased_live_s(
            np.array([done.exposure_s]), np.array([histogram.flags], dtype=np.uint16), self._plan.stop
        )
        self._counts[point.row, point.col] += done.counts
        self._variance[point.row, point.col] += done.variance
        self._direct[point.row, point.col] += done.direct
        self._usable &= done.usable
        self._exposure_s[point.row, point.col] += live_s[0]

    def transient(self) -> "Transient":
        """What came so far, time 0 at the direct arrival, of a wall that is as bright everywhere. A copy."""
        counts = np.ascontiguousarray(np.moveaxis(self._counts, 2, 0))
        return Transient(counts, self._exposure_s * self._light(), self._plan.wall, self._time, self._response)

    def _light(self) -> "npt.NDArray[np.float64] | float":
        """What exposures (H, W) are multiplied by, as those of the finished recording are: see `wall_brightness`."""
        wall, arrivals = self._plan.wall, self._constants.arrivals
        assert arrivals is not None
        x_m, y_m = (grid.reshape(-1) for grid in np.meshgrid(wall.x_m(), wall.y_m()))
        counts, variance = (each.reshape(len(x_m), -1) for each in (self._counts, self._variance))
        usable = np.broadcast_to(self._usable, counts.shape)
        hidden = HiddenLight(counts, variance, usable, self._exposure_s.ravel(), self._direct.ravel(), x_m, y_m)
        found = wall_brightness(hidden, arrivals.scanner_position_m)
        if found is None:
            return 1.0
        doubt_wall_brightness(found)
        return found.light.reshape(self._exposure_s.shape)
