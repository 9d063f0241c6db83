"""Where the doctor sends the beam: within the bench's allowed area, and within the mirror's reach."""

import math
from dataclasses import dataclass

import numpy as np

from nlos.acquisition.planning.preflight import aim_of
from nlos.drivers.bench import Bench
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles

_WITHOUT_ALLOWED = 0.25
"""Half the width of the area, in wall distances, where the bench file allows everything."""
_TIMES = 40
_SMALLER = 0.9
_INSIDE = 0.999
"""Of it: its edges are safe from rounding."""


@dataclass(frozen=True)
class WallArea:
    """A rectangle on the wall's plane, metres."""

    left_m: float
    right_m: float
    bottom_m: float
    top_m: float

    @property
    def centre(self) -> tuple[float, float]:
        return (self.left_m + self.right_m) / 2, (self.bottom_m + self.top_m) / 2

    @property
    def corners(self) -> list[tuple[float, float]]:
        return [(x, y) for y in (self.top_m, self.bottom_m) for x in (self.left_m, self.right_m)]

    @property
    def nearest(self) -> tuple[float, float]:
        """The point nearest to the undeflected beam."""
        return min(max(0.0, self.left_m), self.right_m), min(max(0.0, self.bottom_m), self.top_m)

    @property
    def farthest(self) -> tuple[float, float]:
        """The corner farthest from the undeflected beam."""
        return max(self.corners, key=lambda corner: math.hypot(*corner))

    def within(self, half_m: float) -> "WallArea":
        """The part of it around its centre that is at most `half_m` from it on every side."""
        x, y = self.centre
        return WallArea(
            max(self.left_m, x - half_m), min(self.right_m, x + half_m),
            max(self.bottom_m, y - half_m), min(self.top_m, y + half_m),
        )  # fmt: skip

    def __str__(self) -> str:
        return f"x {self.left_m:+.2f} to {self.right_m:+.2f} m, y {self.bottom_m:+.2f} to {self.top_m:+.2f} m"


def area_of(bench: Bench) -> WallArea:
    """The allowed area, or a square around the undeflected beam, made smaller about its centre until the mirror reaches
    its corners. Raises `LimitError` where it reaches nothing of it."""
    geometry = bench.settings.geometry
    half_m = _WITHOUT_ALLOWED * geometry.wall_distance_m
    allowed = geometry.allowed
    whole = (
        WallArea(-half_m, half_m, -half_m, half_m)
        if allowed is None
        else WallArea(allowed.left_m, allowed.right_m, allowed.bottom_m, allowed.top_m)
    )
    x, y = whole.centre
    half_width_m, half_height_m = whole.right_m - x, whole.top_m - y
    for turn in range(_TIMES):
        part = _INSIDE * _SMALLER**turn
        area = WallArea(x - part * half_width_m, x + part * half_width_m,
                        y - part * half_height_m, y + part * half_height_m)  # fmt: skip
        try:
            for corner in area.corners:
                bench.mirror.check(angles_of(bench, corner))
        except LimitError:
            continue
        return area
    raise LimitError("mirror", f"does not reach the allowed area ({whole}).", "Correct geometry.allowed or the mirror.")


def angles_of(bench: Bench, place: tuple[float, float]) -> MirrorAngles:
    """The mirror angles of a place on the wall, by the bench file's geometry."""
    return aim_of(bench).angles(*place)


def range_m(bench: Bench, place: tuple[float, float]) -> float:
    """From the scanner to a place on the wall."""
    angles = angles_of(bench, place)
    return float(aim_of(bench).ranges_m(np.float64(angles.x_rad), np.float64(angles.y_rad)))
