"""Where the scanner stands, from spots alone: before any scan, for mirrors that turn by as much as they are told."""

import math
from dataclasses import dataclass, replace

import numpy as np

from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.geometry_fit import GeometryFit, Spots, fit_geometry

PLACE = ("scanner_x_m", "scanner_y_m", "wall_distance_m", "wall_pitch_rad", "wall_yaw_rad")
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
    free, undetermined = list(PLACE), {}
    start = replace(drawn, x_gain=1.0, y_gain=1.0, x_offset_rad=0.0, y_offset_rad=0.0)
    while True:
        try:
            fit = fit_geometry(start, spots=spots, free=free)
        except InvalidData:
            if not (leaning := [name for name in free if name.startswith(("wall_p", "wall_y"))]):
                raise
            free.remove(leaning[0])
            undetermined[leaning[0]] = (getattr(drawn, leaning[0]), math.inf)
            continue
        worst = max(free, key=lambda name: fit.errors[name] / WORTH[name])
        if fit.errors[worst] <= WORTH[worst] or len(free) == 1:
            return PlacedScanner(fit, undetermined)
        free.remove(worst)
        undetermined[worst] = (getattr(fit.geometry, worst), fit.errors[worst])


def poorly_determined(fit: GeometryFit) -> list[str]:
    """Fitted parameters whose errors say that the data did not tell them."""
    return [name for name, error in fit.errors.items() if name in WORTH and error > WORTH[name]]


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
