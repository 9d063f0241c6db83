"""What is wrong with a table of spots as a whole, before anything is fitted: axes swapped or reversed, other units."""

import numpy as np
import numpy.typing as npt

from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry_fit import Spots

Floats = npt.NDArray[np.float64]
_AT_MOST = 5.0
"""Times the bench file's distance, or its inverse: no tape measure is that wrong."""
_OTHER_UNITS = {1000.0: "millimetres", 100.0: "centimetres", 39.37: "inches"}


def check_sense(spots: Spots) -> None:
    """Raises `InvalidData`, with what to change, where the beam goes another way than it is sent."""
    if len(spots.x_rad) < 3:
        return
    if not span_the_wall(spots):
        raise InvalidData("the spots lie on one line, or on one another: mark some to the sides and above as well.")
    (x_by_x, y_by_x), (x_by_y, y_by_y), _ = _straight(spots)
    if abs(x_by_y) > abs(x_by_x) and abs(y_by_x) > abs(y_by_y):
        raise InvalidData(
            "x and y are swapped: sent to the side, the beam goes up or down. Exchange the axes in the bench file's "
            "mirror block, or the cables to the head; then mark the spots again, or exchange x_deg and y_deg in the "
            "table."
        )
    for name, slope in (("x", x_by_x), ("y", y_by_y)):
        if slope < 0:
            raise InvalidData(
                f"{name} is reversed: the beam goes the other way. Turn the sign of that axis in the bench file's "
                f"mirror block (volts_per_degree, invert_{name}); then mark the spots again, or turn the sign of "
                f"{name}_deg in the table."
            )


def span_the_wall(spots: Spots) -> bool:
    """Whether there are three that do not lie on one line."""
    return len(spots.x_rad) >= 3 and int(np.linalg.matrix_rank(_sent(spots), tol=1e-6)) == 3


def refuse_other_units(spots: Spots, drawn_m: float) -> None:
    """Raises `InvalidData` where the spots put the wall several times as far away as the bench file does (`drawn_m`),
    with the unit that explains it."""
    if len(spots.x_rad) < 3:
        return
    (x_by_x, _), (_, y_by_y), _ = _straight(spots)
    far_m = float(np.sqrt(abs(x_by_x * y_by_y)))
    ratio = far_m / drawn_m
    if 1 / _AT_MOST <= ratio <= _AT_MOST:
        return
    unit = min(_OTHER_UNITS, key=lambda factor: abs(np.log(ratio / factor)))
    if abs(np.log(ratio / unit)) < np.log(1.5):
        advice = (
            f"Are these {_OTHER_UNITS[unit]}? x_m and y_m are metres; then the wall would be {far_m / unit:.3g} m away."
        )
    elif ratio < 1:
        advice = "x_m and y_m are metres, x_deg and y_deg optical degrees; correct the table, or wall_distance_m."
    else:
        advice = "x_deg and y_deg are degrees, x_m and y_m metres; correct the table, or wall_distance_m."
    raise InvalidData(
        f"by these spots the wall is {far_m:.4g} m away, by the bench file's wall_distance_m {drawn_m:g} m. {advice}"
    )


def _sent(spots: Spots) -> Floats:
    return np.column_stack([spots.x_rad, spots.y_rad, np.ones(len(spots.x_rad))])


def _straight(spots: Spots) -> Floats:
    """Wall place (x, y) by angle x, by angle y, and at zero, shape (3, 2), in metres a radian: by least absolute
    residuals, so that one mistyped row turns nothing round."""
    sent, seen = np.tan(_sent(spots)), np.column_stack([spots.x_m, spots.y_m])
    sent[:, 2] = 1.0
    weight = np.ones(len(sent))
    for _ in range(40):
        root = np.sqrt(weight)[:, None]
        along, *_ = np.linalg.lstsq(sent * root, seen * root, rcond=None)
        off = np.hypot(*(seen - sent @ along).T)
        weight = 1 / np.maximum(off, 1e-3 * max(float(np.abs(seen).max()), 1e-9))
    return np.asarray(along)
