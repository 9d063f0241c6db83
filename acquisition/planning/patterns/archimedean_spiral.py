"""Archimedean spiral, r = a theta, with points at equal distances along it."""

import math
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.positions import Positions, free
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings


class ArchimedeanSpiral(Settings):
    """A spiral whose turns are `dr_m` apart, with points `spacing_m` apart along it (default: as far as the turns).

    `dr` and `tilt` as in bluesky's `spiral`.
    """

    kind: Literal["archimedean_spiral"] = "archimedean_spiral"
    dr_m: float = Field(gt=0)
    """Distance between turns."""
    spacing_m: float | None = Field(default=None, gt=0)
    """Distance between points along the spiral; that between turns unless given."""
    tilt_deg: float = 0.0
    """Turns the spiral about the wall's centre."""

    def points(self, wall: WallGrid) -> Positions:
        """From the centre out to the wall's nearer edges. Raises `PlanRefused` for more than a million points."""
        growth_m = self.dr_m / (2 * math.pi)
        end_m = min(wall.width_m, wall.height_m) / 2
        spacing_m = self.spacing_m or self.dr_m
        length_m = float(_length_m(np.array(end_m / growth_m), growth_m))
        if length_m / spacing_m > 1e6:
            raise PlanRefused(f"a spiral of {length_m:.3g} m has too many points {spacing_m:g} m apart")
        along_m = np.arange(int(length_m / spacing_m) + 1) * spacing_m
        theta = np.sqrt(2 * along_m / growth_m)
        for _ in range(8):  # Newton: d length / d theta = a sqrt(1 + theta^2)
            theta -= (_length_m(theta, growth_m) - along_m) / (growth_m * np.sqrt(1 + theta**2))
        angle = theta + math.radians(self.tilt_deg)
        return free(growth_m * theta * np.cos(angle), growth_m * theta * np.sin(angle))


def _length_m(theta: npt.NDArray[np.float64], growth_m: float) -> npt.NDArray[np.float64]:
    """Length of r = a theta from the centre: a/2 (theta sqrt(1 + theta^2) + asinh theta)."""
    return np.asarray(growth_m / 2 * (theta * np.sqrt(1 + theta**2) + np.arcsinh(theta)))
