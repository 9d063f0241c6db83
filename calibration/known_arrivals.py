"""Direct arrivals by known constants, and how long a record lasts behind them."""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.calibration.arrival_rounds import TimeOffsets
from nlos.calibration.constants import BenchConstants
from nlos.calibration.errors import InvalidData, NothingBehind
from nlos.calibration.raw_points import RawPoints

Floats = npt.NDArray[np.float64]
SHORTEST_S = 1.3e-9
"""A record that ends sooner than this after the direct arrival holds the direct light and nothing else."""

DRIFT_S = 100e-12
"""By which time zero may have changed since constants were measured: hidden light comes later than that."""


def common_bins(constants: BenchConstants, x_m: npt.ArrayLike, y_m: npt.ArrayLike, time: TimeAxis) -> int:
    """Bins from the direct arrival on that all of these points record."""
    require_arrivals(constants, time)
    latest = float(known_arrival_bins(constants, x_m, y_m, time).max())
    if not latest < time.bins - 1:
        raise InvalidData(
            f"direct light arrives up to bin {latest:.0f}, but the record has {time.bins}: lengthen the histogram."
        )
    return time.bins - int(np.ceil(latest))


def known_arrival_bins(constants: BenchConstants, x_m: npt.ArrayLike, y_m: npt.ArrayLike, time: TimeAxis) -> Floats:
    """Direct arrivals by the constants, in bins after the start of the record."""
    assert constants.arrivals is not None
    return np.asarray((constants.arrivals.at(x_m, y_m) - time.start_s) / time.bin_width_s)


def is_direct(offsets: TimeOffsets, known_bins: Floats) -> bool:
    """Whether arrivals that a scan shows itself are direct light's, where constants know them, too, (N,): a wall that
    is only drawn explains hidden light at points that lie close together."""
    if offsets.wall is None or not offsets.wall.drawn:
        return offsets.on_a_plane
    off_s = np.abs(offsets.measured_bins - known_bins)[offsets.found] * offsets.bin_width_s
    return bool(offsets.on_a_plane and np.median(off_s) < DRIFT_S)


def require_arrivals(constants: BenchConstants, time: TimeAxis) -> None:
    """Raises `InvalidData` for constants without arrivals, or for another bin width."""
    if constants.arrivals is None:
        raise InvalidData("these constants hold no direct arrivals: calibrate with a scan, not only with a dark run.")
    if abs(constants.bin_width_s / time.bin_width_s - 1) > 1e-6:
        raise InvalidData(
            f"these constants are for bins of {constants.bin_width_s * 1e12:.2f} ps, the data have "
            f"{time.bin_width_s * 1e12:.2f} ps."
        )


def bins_left(raw: RawPoints, arrival: Floats, offsets: TimeOffsets | None) -> int:
    """Bins from the direct arrival on that every point recorded, strays aside: one must not shorten all others."""
    held = arrival if offsets is None else np.where(offsets.stray, -np.inf, arrival)
    point = int(np.argmax(held))
    bins = raw.time.bins - int(np.ceil(held[point]))
    if offsets is not None and bins * raw.time.bin_width_s < SHORTEST_S:
        raise NothingBehind(
            f"{raw.name(point)}: direct light arrives in bin {held[point]:.0f} of {raw.time.bins}; no hidden scene was "
            "recorded behind it. Lengthen the histogram or start it later."
        )
    return bins
