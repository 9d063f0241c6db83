"""From galvo volts or unit-circle coordinates to wall positions by a projective map: the galvo seen as a projector.

The first stage of the wall's geometry: exact from four spots for a central beam and a plane wall. Two mirrors that
stand apart add a pincushion of a few millimetres, which the model in `geometry.py` takes from nine spots or more.
"""

import numpy as np
import numpy.typing as npt

from nlos.calibration.errors import InvalidData

Floats = npt.NDArray[np.float64]
UNIT_CIRCLE_RAD = np.deg2rad(50.0)
"""Optical deflection at the edge of the unit circle of a steering mirror (Optotune MR-E-2 manual)."""


def angles_from_volts(volts: npt.ArrayLike, mechanical_deg_per_volt: float = 2.0) -> Floats:
    """Optical angle of an analogue galvo: twice the mechanical one (Thorlabs GVS012: 0.5 V per degree)."""
    return np.deg2rad(2 * mechanical_deg_per_volt * np.asarray(volts, dtype=np.float64))


def slopes_from_unit_circle(x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Tangents of a steering mirror's beam from its unit-circle coordinates: linear, x = tan(angle) / tan(50 deg)."""
    scale = np.tan(UNIT_CIRCLE_RAD)
    return np.asarray(x, dtype=np.float64) * scale, np.asarray(y, dtype=np.float64) * scale


def slopes_from_angles(x_rad: npt.ArrayLike, y_rad: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Tangents of a two-mirror head's beam, mirror separation neglected: tan(x) / cos(y), tan(y)."""
    y = np.asarray(y_rad, dtype=np.float64)
    return np.asarray(np.tan(x_rad) / np.cos(y)), np.asarray(np.tan(y))


def fit_homography(slopes: npt.ArrayLike, spots_m: npt.ArrayLike) -> Floats:
    """The 3 x 3 projective map from beam tangents (N, 2) to wall positions (N, 2): exact for four points of a
    central beam and a plane wall, least squares for more (normalised DLT, Hartley & Zisserman, algorithm 4.2)."""
    source, target = np.asarray(slopes, dtype=np.float64), np.asarray(spots_m, dtype=np.float64)
    if source.shape != target.shape or len(source) < 4:
        raise InvalidData(f"{len(source)} tangents and {len(target)} spots are given; a homography needs four of each.")
    from_source, from_target = _normalising(source), _normalising(target)
    s, t = apply_homography(from_source, source), apply_homography(from_target, target)
    zero, one = np.zeros(len(s)), np.ones(len(s))
    upper = np.column_stack([s, one, zero, zero, zero, -t[:, :1] * s, -t[:, 0]])
    lower = np.column_stack([zero, zero, zero, s, one, -t[:, 1:] * s, -t[:, 1]])
    _, strength, vectors = np.linalg.svd(np.concatenate([upper, lower]))
    if strength[7] < 1e-9 * strength[0]:
        raise InvalidData("three of the four points lie on one line: choose points that span the wall.")
    full = np.linalg.inv(from_target) @ vectors[-1].reshape(3, 3) @ from_source
    return np.asarray(full / full[2, 2])


def apply_homography(homography: Floats, points: npt.ArrayLike) -> Floats:
    """Maps points (N, 2)."""
    mapped = np.column_stack([np.asarray(points, dtype=np.float64), np.ones(len(np.asarray(points)))]) @ homography.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _normalising(points: Floats) -> Floats:
    """Centres points and scales them to a mean distance of sqrt 2."""
    centre = points.mean(axis=0)
    scale = np.sqrt(2) / max(float(np.hypot(*(points - centre).T).mean()), 1e-300)
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])
