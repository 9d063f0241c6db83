"""Where a recording's bench has scanner and wall: by constants that aimed the scan, else as its file draws them."""

import json
from collections.abc import Mapping
from math import radians

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.aim import Aim
from nlos.calibration.constants import geometry_of
from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry import ScannerGeometry


def aimed_by(constants_json: str, bench_json: str) -> Aim | ScannerGeometry | None:
    """The earlier constants' geometry where they took part in the scan, else the bench file's; None without either.
    Raises `InvalidData` for one that cannot be read."""
    try:
        fitted, drawn = (json.loads(text).get("geometry") for text in (constants_json, bench_json))
        if fitted:
            return geometry_of(fitted)
        return _drawn(drawn) if drawn else None
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise InvalidData(f"header: the geometry of the bench cannot be read ({error})") from error


def scanner_of(aim: Aim | ScannerGeometry | None) -> npt.NDArray[np.float64] | None:
    """(3,): the scanner in wall coordinates; None where nobody says."""
    if aim is None or isinstance(aim, ScannerGeometry):
        return None if aim is None else aim.scanner_m
    return ScannerGeometry(**vars(aim)).scanner_m


def _drawn(geometry: Mapping[str, float]) -> Aim:
    """As the bench file of a recording drew it."""
    lengths = ("wall_distance_m", "mirror_separation_m", "scanner_x_m", "scanner_y_m")
    angles = ("wall_pitch_deg", "wall_yaw_deg")
    return Aim(
        float(geometry["wall_distance_m"]),
        *(float(geometry.get(key, 0.0)) for key in lengths[1:]),
        *(radians(float(geometry.get(key, 0.0))) for key in angles),
    )
