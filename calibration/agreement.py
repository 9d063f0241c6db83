"""Whether what a scan and a ruler say goes together: places of the wall where it was aimed and where it landed."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.aim import Aim
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.arrival_rounds import TimeOffsets
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.geometry_fit import GeometryFit
from nlos.calibration.matched_filter import neighbours
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.spots_fit import PlacedScanner
from nlos.calibration.wall_timing import WallTiming, fit_wall_timing

Floats = npt.NDArray[np.float64]
_DOUBT, _SURE = 3.0, 4.0
"""Standard errors by which two answers to one question may differ: ruler and times; two fits of the same times."""
_SMALLEST_M = 2e-3
_BESIDE_M = 5e-3
"""Points that landed further from where they were aimed put a picture elsewhere."""
_BESIDE, _FEWEST = 4, 25
"""Neighbours of a point that are looked at, and points that tell."""
_UNEVEN_S = 3e-12
"""What neighbours share of their distance from a plane: half a millimetre puts the scanner centimetres elsewhere."""


@dataclass(frozen=True)
class Landed:
    """Where the points of a scan landed on the wall, and the fit of their arrivals with that."""

    x_m: Floats  # (N,)
    y_m: Floats
    wall: WallTiming | None


def landed_at(raw: RawPoints, offsets: TimeOffsets, aim: Aim | ScannerGeometry, fit: GeometryFit) -> Landed:
    """By the angles that were sent for `aim` and the geometry that was found."""
    x_m, y_m = fit.geometry.wall_points(*aim.angles_rad(raw.x_m, raw.y_m))
    width_s = raw.time.bin_width_s
    arrival_s = raw.time.start_s + offsets.measured_bins * width_s
    return Landed(x_m, y_m, fit_wall_timing(arrival_s, offsets.error_bins * width_s, x_m, y_m))


def off_its_aim(placed: PlacedScanner, landed: Landed, raw: RawPoints) -> str:
    """What to say of a scan whose points landed elsewhere, by spots that tell; empty where they did not. It is the
    scan's own: the constants are right, and scans that they aim are."""
    off_m = float(np.hypot(landed.x_m - raw.x_m, landed.y_m - raw.y_m).max())
    if placed.spots_alone is None or placed.times_alone is None or off_m <= _BESIDE_M:
        return ""
    return (
        f"this scan landed up to {off_m * 1e3:.0f} mm from where it was aimed, and its picture is off by as much. Scan "
        "again with these constants"
    )


def disagreements(placed: PlacedScanner, landed: Landed, aimed: WallTiming, raw: RawPoints) -> list[str]:
    """Sentences, each with both values and what to do; none where everything goes together."""
    found, fit = [], placed.fit
    spots, times = placed.spots_alone, placed.times_alone
    if spots is not None and times is not None:
        ruler, error = spots.geometry.wall_distance_m, spots.errors.get("wall_distance_m", 0.0)
        by_times, its_error = times.geometry.wall_distance_m, times.errors["wall_distance_m"]
        if abs(ruler - by_times) > _DOUBT * float(np.hypot(error, its_error)):
            taken = "gains that are not 1 explain it and were taken" if placed.freed else "nothing explains it"
            found.append(
                f"spots alone put the wall at {ruler:.4f} +- {error:.4f} m, direct times alone at {by_times:.4f} +- "
                f"{its_error:.4f} m, for mirrors that turn as told; {taken}. Mark more spots, far out and at places "
                "off a grid, and check volts_per_degree"
            )
    elif landed.wall is not None:
        by_angles, by_places = float(landed.wall.scanner_position_m[2]), float(aimed.scanner_position_m[2])
        errors = [float(np.sqrt(each.covariance[2, 2])) for each in (landed.wall, aimed)]
        sure_m = _SURE * float(np.linalg.norm(errors))
        if abs(by_angles - by_places) > max(sure_m, _SMALLEST_M):
            found.append(
                f"by the angles sent the wall is {fit.geometry.wall_distance_m:.4f} +- {errors[0]:.4f} m away, by the "
                f"places aimed at {by_places:.4f} +- {errors[1]:.4f} m: the beam did not land where the plan "
                "says, and the bench file's wall_distance_m, the scanner's place or the mirror's volts per degree are "
                "wrong. Mark spots (`nlos jog`) and calibrate with --spots before these constants are used"
            )
    return found


def uneven(offsets: TimeOffsets, x_m: Floats, y_m: Floats) -> list[str]:
    """What to say where neighbouring points are off the plane wall's times alike, which chance does not make them: then
    the errors of the fit, for which each point is off on its own, are too small."""
    if offsets.wall is None:
        return []
    good = offsets.found & offsets.wall.accepted
    if good.sum() < _FEWEST:
        return []
    off_s = offsets.residual_bins[good] * offsets.bin_width_s
    beside_s = off_s[neighbours(x_m[good], y_m[good], 1 + _BESIDE)[:, 1:]].mean(axis=1)
    shared_s2 = float(np.mean(off_s * beside_s))
    by_chance_s2 = float(np.mean(off_s**2)) / np.sqrt(len(off_s) * _BESIDE / 2)
    if not shared_s2 > max(_UNEVEN_S**2, _SURE * by_chance_s2):
        return []
    shared_s = float(np.sqrt(shared_s2))
    return [
        f"direct times are {shared_s * 1e12:.0f} ps ({shared_s * SPEED_OF_LIGHT_M_PER_S / 2 * 1e3:.1f} mm) off a plane "
        "wall's, alike at neighbouring points: the wall is curved or has steps, or time zero drifted. Scanner, wall "
        "and delay are farther off than their errors say. Aim at a plane part, or have the scanner's place by spots"
    ]
