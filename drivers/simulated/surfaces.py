"""Hidden surfaces as a bench file describes them, cut into small flat pieces (surfels)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import pi, sqrt

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from nlos.configs.settings import Settings
from nlos.drivers.simulated import font
from nlos.drivers.simulated.motion import Pose, Vector, Waypoint, poses

Array = npt.NDArray[np.float64]


class Surface(Settings):
    """One hidden surface: a letter, a bitmap, a flat panel or a sphere, in wall coordinates (z away from the wall).

    `bitmap` is a list of text rows, top row first: a digit 1-9 is that many ninths of the albedo, `.`, `0` and space
    are empty, any other character is full albedo. Letters and bitmaps are `height_m` tall with square cells. Flat
    surfaces face the wall; `pitch_deg` tips their top edge away from it, `yaw_deg` swings their right edge away.
    """

    letter: str | None = None
    """A capital letter or digit."""
    bitmap: tuple[str, ...] | None = None
    """Rows of text: # is white, 1 to 9 are shades, . is nothing."""
    panel_m: tuple[float, float] | None = None
    """Width and height of a flat panel."""
    sphere_m: float | None = Field(default=None, gt=0)
    """Radius."""
    centre_m: Vector
    """Its centre: x, y, and z from the wall."""
    height_m: float | None = Field(default=None, gt=0)
    """Height of a letter or bitmap."""
    albedo: float = Field(default=1.0, ge=0, le=1)
    """0 to 1."""
    pitch_deg: float = Field(default=0.0, ge=-90, le=90)
    """Its top edge tips away from the wall."""
    yaw_deg: float = Field(default=0.0, ge=-90, le=90)
    """Its right edge swings away from the wall."""
    roll_deg: float = 0.0
    """It is turned in its own plane, its right edge upwards."""
    retroreflective: bool = False
    """Sends light back where it came from."""
    path: tuple[Waypoint, ...] = ()
    """Where it moves and turns to, from its place at 0 s; it rests at the last one."""
    appears_s: float = Field(default=0.0, ge=0)
    """When it appears, in seconds since the first point was lit."""
    vanishes_s: float | None = Field(default=None, gt=0)
    """When it vanishes; never unless given."""

    @model_validator(mode="after")
    def _is_one_shape(self) -> "Surface":
        shapes = {"letter": self.letter, "bitmap": self.bitmap, "panel_m": self.panel_m, "sphere_m": self.sphere_m}
        given = [name for name, value in shapes.items() if value is not None]
        if len(given) != 1:
            raise ValueError(f"a surface is one of {', '.join(shapes)} (found {', '.join(given) or 'none'})")
        needs_height = given[0] in ("letter", "bitmap")
        if needs_height != (self.height_m is not None):
            raise ValueError(f"a {given[0]} {'needs' if needs_height else 'takes no'} height_m")
        if self.letter is not None and (len(self.letter) != 1 or self.letter not in font.LETTERS):
            raise ValueError(f"letter {self.letter!r} is not in the font ({font.LETTERS}); draw it as a bitmap")
        if self.bitmap is not None and not any(_cell_albedo(cell) for row in self.bitmap for cell in row):
            raise ValueError("the bitmap has no filled cell")
        if self.panel_m is not None and not (self.panel_m[0] > 0 and self.panel_m[1] > 0):
            raise ValueError(f"panel_m must be above 0 (given {self.panel_m})")
        if self.centre_m[2] <= (self.sphere_m or 0.0):
            raise ValueError(f"centre_m[2] = {self.centre_m[2]:g} m does not lie in front of the wall")
        self._check_path()
        return self

    def _check_path(self) -> None:
        times_s = [0.0, *(point.at_s for point in self.path)]
        if any(later <= earlier for earlier, later in pairwise(times_s)):
            raise ValueError(f"the path's at_s must grow from one waypoint to the next (given {times_s[1:]})")
        for point, pose in zip(self.path, poses(self.pose, self.path)[1:], strict=True):
            if pose.centre_m[2] <= (self.sphere_m or 0.0):
                raise ValueError(f"at {point.at_s:g} s, z = {pose.centre_m[2]:g} m does not lie in front of the wall")
            if max(abs(pose.pitch_deg), abs(pose.yaw_deg)) > 90:
                raise ValueError(f"at {point.at_s:g} s, it is turned by more than 90 degrees: it faces away")
        if self.vanishes_s is not None and self.vanishes_s <= self.appears_s:
            raise ValueError(f"vanishes_s = {self.vanishes_s:g} is not after appears_s = {self.appears_s:g}")

    @property
    def pose(self) -> Pose:
        """Its place and turn at 0 s."""
        return Pose(self.centre_m, self.pitch_deg, self.yaw_deg, self.roll_deg)

    @property
    def moves(self) -> bool:
        """Whether it is not always there in the same place."""
        return bool(self.path) or self.appears_s > 0 or self.vanishes_s is not None

    def is_there(self, time_s: float) -> bool:
        """Whether there is anything of it at this moment."""
        return self.appears_s <= time_s and (self.vanishes_s is None or time_s < self.vanishes_s)


@dataclass(frozen=True)
class Surfels:
    """Positions and unit normals, each (N, 3); `reflectance_m2` (N,) is albedo times area; `retroreflective` (N,)."""

    positions_m: Array
    normals: Array
    reflectance_m2: Array
    retroreflective: npt.NDArray[np.bool_]


def surfels(surfaces: Sequence[Surface], spacing_m: float) -> Surfels:
    """All surfaces cut into pieces of about `spacing_m` x `spacing_m`. They do not shadow one another."""
    parts = [_cut(surface, spacing_m) for surface in surfaces]
    if not parts:
        return Surfels(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=bool))
    counts = [len(part[0]) for part in parts]
    return Surfels(
        positions_m=np.concatenate([part[0] for part in parts]),
        normals=np.concatenate([part[1] for part in parts]),
        reflectance_m2=np.concatenate([part[2] for part in parts]),
        retroreflective=np.repeat([surface.retroreflective for surface in surfaces], counts),
    )


def _cut(surface: Surface, spacing_m: float) -> tuple[Array, Array, Array]:
    if surface.sphere_m is not None:
        return _cut_sphere(surface, surface.sphere_m, spacing_m)
    if surface.panel_m is not None:
        cells = np.ones((1, 1))
        width_m, height_m = surface.panel_m
    else:
        rows = surface.bitmap if surface.bitmap is not None else font.bitmap(surface.letter or "")
        columns = max(len(row) for row in rows)
        cells = np.array([[_cell_albedo(cell) for cell in row.ljust(columns)] for row in rows])
        height_m = surface.height_m or 0.0
        width_m = height_m * columns / len(rows)
    return _cut_flat(surface, cells, width_m, height_m, spacing_m)


def _cut_flat(
    surface: Surface, cells: Array, width_m: float, height_m: float, spacing_m: float
) -> tuple[Array, Array, Array]:
    across = max(1, round(width_m / cells.shape[1] / spacing_m))
    down = max(1, round(height_m / cells.shape[0] / spacing_m))
    fine = cells.repeat(down, axis=0).repeat(across, axis=1)
    row, column = np.nonzero(fine)
    u = ((column + 0.5) / fine.shape[1] - 0.5) * width_m
    v = (0.5 - (row + 0.5) / fine.shape[0]) * height_m
    right, up, away = surface.pose.rotation.T
    normal = -away
    positions = np.array(surface.centre_m) + u[:, None] * right + v[:, None] * up
    area_m2 = width_m * height_m / fine.size
    return positions, np.broadcast_to(normal, positions.shape), fine[row, column] * surface.albedo * area_m2


def _cut_sphere(surface: Surface, radius_m: float, spacing_m: float) -> tuple[Array, Array, Array]:
    # A Fibonacci lattice: equal areas without poles.
    count = max(32, round(4 * pi * radius_m**2 / spacing_m**2))
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    turn = index * pi * (1 + sqrt(5))
    ring = np.sqrt(1 - z**2)
    normals = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    area_m2 = 4 * pi * radius_m**2 / count
    positions = np.array(surface.centre_m) + radius_m * normals
    return positions, normals, np.full(count, surface.albedo * area_m2)


def _cell_albedo(cell: str) -> float:
    if cell in " .0":
        return 0.0
    return int(cell) / 9 if cell in "123456789" else 1.0
