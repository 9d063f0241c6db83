"""Angles as the codes of an analogue head's two axes, or the refusal of what is beyond head or DAC."""

import math
from collections.abc import Callable

from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles

CodeFor = Callable[[float], int]
"""Optical angle in rad -> code; raises `ValueError` beyond the DAC."""
_REMEDY = "Shrink the wall in the plan, aim nearer to its middle, or move the scanner back."


def axis_codes(
    device: str, angles: MirrorAngles, max_mechanical_deg: float, x_code: CodeFor, y_code: CodeFor
) -> tuple[int, int]:
    """Raises `LimitError` beyond the head's angle, which is mechanical, or the DAC's range."""
    limit_deg = 2.0 * max_mechanical_deg
    codes = []
    for name, code_for, angle_rad in (("x", x_code, angles.x_rad), ("y", y_code, angles.y_rad)):
        what = f"mirror {name} = {math.degrees(angle_rad):+.2f} deg optical"
        if not abs(math.degrees(angle_rad)) <= limit_deg:
            raise LimitError(device, f"{what} is outside +-{limit_deg:.2f} deg optical.", _REMEDY)
        try:
            codes.append(code_for(angle_rad))
        except ValueError as error:
            raise LimitError(device, f"{what} {error}.", _REMEDY) from error
    return codes[0], codes[1]
