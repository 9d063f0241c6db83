"""The order of the corrections, in one place: check, align to the direct arrival, subtract the background, remove
the direct light."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from calibration.alignment import align, align_by_floor_and_circshift, align_variance, recorded_bins
from calibration.background import Background, before_pulse, subtract
from calibration.direct_reflection import DirectLight, find_direct_light, remove_direct_light
from calibration.errors import InvalidData, NoDirectPeak
from calibration.impulse_response import ImpulseResponse
from calibration.time_offset import TimeOffsets, measure_time_offsets

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class CorrectedPoints:
    """Histograms of N points on one time axis whose time 0 is the direct arrival."""

    counts: npt.NDArray[np.float32]  # (N, T); negative where chance has it so
    variance: npt.NDArray[np.float32]  # (N, T)
    usable: npt.NDArray[np.bool_]  # (N, T); False where direct light hides the scene or nothing was recorded
    exposure_s: Floats  # (N,); 0 where no arrival is known
    time: TimeAxis
    offsets: TimeOffsets | None
    """None where the arrivals were given."""
    direct: DirectLight
    background: Background

    def report(self) -> dict[str, float | int | list[float] | None]:
        """Figures for people and JSON: what was found, and how well it fits."""
        offsets, width = self.offsets, self.time.bin_width_s
        wall = offsets.wall if offsets else None
        rms_s = offsets.rms_bins * width if offsets and wall else None
        measured = self.exposure_s > 0
        return {
            "points": len(self.counts),
            "points_without_direct_peak": int((~offsets.found & measured).sum()) if offsets else None,
            "points_off_the_wall_fit": int((~wall.accepted & measured).sum()) if wall else None,
            "offset_rms_bins": offsets.rms_bins if offsets and wall else None,
            "offset_rms_ps": rms_s * 1e12 if rms_s is not None else None,
            "offset_rms_mm": rms_s * SPEED_OF_LIGHT_M_PER_S / 2 * 1e3 if rms_s is not None else None,
            "scanner_position_m": [float(v) for v in wall.scanner_position_m] if wall else None,
            "electronic_delay_ns": wall.delay_s * 1e9 if wall else None,
            "response_fwhm_ps": offsets.response.fwhm_s() * 1e12 if offsets else None,
            "direct_masked_ns": self.direct.end_bin * width * 1e9,
            "direct_tail_ps": self.direct.decay_bins * width * 1e12,
            "background_per_bin": float(np.mean(self.background.per_bin)),
        }


@dataclass(frozen=True)
class Corrected:
    """A transient that the physics can use, and everything that was taken out of it, on the wall's grid."""

    transient: Transient
    mask: npt.NDArray[np.bool_]  # (T, H, W); True where usable
    variance: npt.NDArray[np.float32]  # (T, H, W)
    points: CorrectedPoints

    def report(self) -> dict[str, float | int | list[float] | None]:
        """See `CorrectedPoints.report`."""
        return self.points.report()


def correct_points(
    counts: npt.ArrayLike,
    x_m: npt.ArrayLike,
    y_m: npt.ArrayLike,
    exposure_s: npt.ArrayLike,
    time: TimeAxis,
    *,
    rectified: bool = False,
    offset_bins: npt.ArrayLike | None = None,
    response: ImpulseResponse | None = None,
    remove_direct: bool = True,
    circshift: bool = False,
) -> CorrectedPoints:
    """Corrects histograms (N, T) of points at `x_m`, `y_m` (N,), exposed for `exposure_s` (N,), 0 = not measured.

    `rectified`: time 0 is the direct arrival already; `offset_bins` (N,): the arrivals are known; otherwise they are
    measured. `circshift`: align as the public f-k code does. The result keeps the bins that every point recorded.
    Raises `InvalidData`, naming the first bad point, and `NoDirectPeak`.
    """
    recorded, exposure = np.asarray(counts), np.asarray(exposure_s, dtype=np.float64)
    check_counts(recorded, exposure)
    points, record = recorded.shape
    offsets: TimeOffsets | None = None
    if rectified:
        arrival = np.full(points, -time.start_s / time.bin_width_s)
    elif offset_bins is not None:
        arrival = np.asarray(offset_bins, dtype=np.float64)
    else:
        offsets = measure_time_offsets(recorded, x_m, y_m, time, response, exposure > 0)
        arrival = offsets.offset_bins
    known = np.isfinite(arrival) & (arrival < record - 1) & (exposure > 0)
    if not known.any():
        raise NoDirectPeak(f"no direct arrival lies inside the record of {record} bins at any of {points} points.")
    arrival = np.where(known, arrival, arrival[known].mean())
    exposure = np.where(known, exposure, 0.0)
    bins = record - max(int(np.ceil(arrival.max())), 0)
    lead = 0.0 if offsets is None else -offsets.response.start_s / time.bin_width_s
    background = before_pulse(recorded, np.where(known, arrival - max(2.0, 2 * lead), 0))
    shift = align_by_floor_and_circshift if circshift else align
    level = np.where(np.isfinite(background.error), background.per_bin, 0.0)
    aligned = subtract(shift(recorded, arrival, bins), level)
    variance = align_variance(recorded, arrival, bins)
    aligned[~known], variance[~known] = 0, 0
    usable = recorded_bins(arrival, record, bins) & known[:, None]
    if remove_direct:
        some = find_direct_light(aligned[known], time.bin_width_s)
        amplitude = np.zeros(points)
        amplitude[known] = some.amplitude
        direct = DirectLight(some.shape, amplitude, some.end_bin, some.decay_bins)
        aligned = remove_direct_light(aligned, direct)
        usable &= direct.usable()
    else:
        direct = DirectLight(np.zeros(bins), np.zeros(points), 0, 0.0)
    aligned[~usable] = 0
    axis = TimeAxis(bins, time.bin_width_s)
    return CorrectedPoints(aligned, variance, usable, exposure, axis, offsets, direct, background)


def correct(
    transient: Transient,
    *,
    rectified: bool = False,
    offset_bins: npt.ArrayLike | None = None,
    response: ImpulseResponse | None = None,
    remove_direct: bool = True,
    circshift: bool = False,
) -> Corrected:
    """`correct_points` for a scan on a grid; `offset_bins` is (H, W)."""
    wall = transient.wall
    x, y = np.meshgrid(wall.x_m(), wall.y_m())
    done = correct_points(
        transient.counts.reshape(transient.time.bins, -1).T,
        x.ravel(),
        y.ravel(),
        transient.exposure_s.ravel(),
        transient.time,
        rectified=rectified,
        offset_bins=None if offset_bins is None else np.asarray(offset_bins).ravel(),
        response=response,
        remove_direct=remove_direct,
        circshift=circshift,
    )
    shape = (done.time.bins, wall.rows, wall.cols)
    return Corrected(
        Transient(_cube(done.counts, shape), done.exposure_s.reshape(shape[1:]), wall, done.time),
        np.ascontiguousarray(done.usable.T).reshape(shape),
        _cube(done.variance, shape),
        done,
    )


def _cube(counts: npt.NDArray[np.float32], shape: tuple[int, int, int]) -> npt.NDArray[np.float32]:
    return np.ascontiguousarray(counts.T).reshape(shape)


def check_counts(counts: npt.NDArray[np.generic], exposure_s: Floats) -> None:
    """Raises `InvalidData` naming the first point whose histogram cannot be one."""
    if counts.ndim != 2 or exposure_s.shape != counts.shape[:1]:
        raise InvalidData(
            f"counts of shape {counts.shape} and exposures of shape {exposure_s.shape} do not belong together."
        )
    if not np.isfinite(exposure_s).all() or (exposure_s < 0).any():
        raise InvalidData(
            f"point {int(np.argmax(~(exposure_s >= 0)))} has an exposure that is negative or not a number."
        )
    if counts.dtype.kind == "f" and not np.isfinite(counts).all():
        point, bin_ = (int(i) for i in np.argwhere(~np.isfinite(counts))[0])
        raise InvalidData(f"point {point}, bin {bin_} is {counts[point, bin_]}: counts must be finite numbers.")
    if counts.dtype.kind != "u" and (counts < 0).any():  # type: ignore[operator]
        point, bin_ = (int(i) for i in np.argwhere(counts < 0)[0])  # type: ignore[operator]
        raise InvalidData(f"point {point}, bin {bin_} is {counts[point, bin_]}: raw counts are never negative.")
