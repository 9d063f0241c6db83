"""Where the scanner stands, from spots alone: before any scan, for mirrors that turn by as much as they are told."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.geometry_fit import DirectTimes, GeometryFit, Spots, fit_geometry

PLACE = ("scanner_x_m", "scanner_y_m", "wall_distance_m", "wall_pitch_rad", "wall_yaw_rad")
OFFSETS = ("y_offset_rad", "x_offset_rad")
LEANS = ("wall_pitch_rad", "wall_yaw_rad")
TURNS_AS_TOLD = {"x_gain": 1.0, "y_gain": 1.0, "x_offset_rad": 0.0, "y_offset_rad": 0.0}
WORTH = {
    "scanner_x_m": 5e-3, "scanner_y_m": 5e-3, "wall_distance_m": 1e-2,
    "wall_pitch_rad": math.radians(0.5), "wall_yaw_rad": math.radians(0.5),
    "x_gain": 0.01, "y_gain": 0.01, "x_offset_rad": math.radians(0.2), "y_offset_rad": math.radians(0.2),
}  # fmt: skip
"""A standard error above this says nothing that a tape measure would not."""


@dataclass(frozen=True)
class PlacedScanner:
    """`undetermined`: what these spots do not tell, with what a fit would have said and its error; it is kept as the
    bench file draws it."""

    fit: GeometryFit
    undetermined: dict[str, tuple[float, float]]


def place_from_spots(spots: Spots, drawn: ScannerGeometry) -> PlacedScanner:
    """The scanner's place, the wall's distance and lean, as far as the spots determine them; the others as `drawn`.

    Raises `InvalidData` for fewer than nine spots, for axes that are swapped or reversed, and for spots on one line.
    """
    check_sense(spots)
    return fit_determined(replace(drawn, **TURNS_AS_TOLD), None, spots, PLACE)


def fit_determined(
    start: ScannerGeometry, times: DirectTimes | None, spots: Spots, free: Sequence[str]
) -> PlacedScanner:
    """`fit_geometry` of as many parameters of `free` as the data determine, the others as in `start`.

    A mirror's offset is let go first: with the scanner's place and the wall's lean it makes a rotation that no spot on
    a plane wall and no arrival tells from none. Raises `InvalidData` where nothing is left to fit.
    """
    left, undetermined = list(free), {}
    while True:
        try:
            fit = fit_geometry(start, times, spots, left)
        except InvalidData:
            if not (loose := [name for name in (*OFFSETS, *LEANS) if name in left]):
                raise
            undetermined[loose[0]] = (getattr(start, loose[0]), math.inf)
        else:
            if not (loose := poorly_determined(fit)) or len(left) == 1:
                return PlacedScanner(fit, undetermined)
            undetermined[loose[0]] = (getattr(fit.geometry, loose[0]), fit.errors[loose[0]])
        left.remove(loose[0])


def poorly_determined(fit: GeometryFit) -> list[str]:
    """Fitted parameters whose errors say that the data did not tell them: offsets first, then the worst."""
    loose = [name for name, error in fit.errors.items() if name in WORTH and error > WORTH[name]]
    return sorted(loose, key=lambda name: (name not in OFFSETS, -fit.errors[name] / WORTH[name]))


def check_sense(spots: Spots) -> None:
    """Raises `InvalidData`, with what to change, where the beam goes another way than it is sent."""
    if len(spots.x_rad) < 3:
        return
    sent = np.column_stack([spots.x_rad, spots.y_rad, np.ones(len(spots.x_rad))])
    if np.linalg.matrix_rank(sent, tol=1e-6) < 3:
        raise InvalidData("the spots lie on one line, or on one another: mark some to the sides and above as well.")
    along, *_ = np.linalg.lstsq(sent, np.column_stack([spots.x_m, spots.y_m]), rcond=None)
    (x_by_x, y_by_x), (x_by_y, y_by_y), _ = along
    if abs(x_by_y) > abs(x_by_x) and abs(y_by_x) > abs(y_by_y):
        raise InvalidData(
            "x and y are swapped: sent to the side, the beam goes up or down. Exchange the axes in the bench file's "
            "mirror block, or the cables to the head."
        )
    for name, slope in (("x", x_by_x), ("y", y_by_y)):
        if slope < 0:
            raise InvalidData(
                f"{name} is reversed: the beam goes the other way. Turn the sign of that axis in the bench file's "
                f"mirror block (volts_per_degree, invert_{name}), then mark the spots again."
            )
