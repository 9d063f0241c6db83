"""One sample of a scan under way, corrected by known constants alone."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.transient import TimeAxis
from nlos.calibration import raw_points
from nlos.calibration.constants import BenchConstants
from nlos.calibration.correct import correct_known


@dataclass(frozen=True)
class CorrectedSample:
    """One sample, corrected by known constants; as in `CorrectedPoints`, for one point."""

    point: ScanPoint
    counts: npt.NDArray[np.float32]  # (T,)
    usable: npt.NDArray[np.bool_]  # (T,)
    exposure_s: float
    time: TimeAxis
    variance: npt.NDArray[np.float32]  # (T,)
    direct: float
    """Photons of direct light."""


def correct_sample(sample: Sample, constants: BenchConstants, bins: int) -> CorrectedSample:
    """`correct_known` for one sample: what a live scan is corrected by. `bins`: length of every corrected histogram,
    see `common_bins`."""
    done = correct_known(raw_points.from_sample(sample), constants, bins)
    told = float(done.exposure_s[0]), done.time, done.variance[0], float(done.direct.amplitude[0])
    return CorrectedSample(sample.point, done.counts[0], done.usable[0], *told)
