"""A simulated bench with hidden objects, and what they look like to somebody who sees around the corner."""

import json
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from nlos.acquisition.wall import WallGrid
from nlos.drivers.simulated.surfaces import Surface, surfels

CREATURE = ["..#..#..", "..####..", ".######.", "##.##.##", "########", ".#.##.#.", "#......#"]
Objects = Sequence[Mapping[str, object]]
"""As the bench file's `simulation.scene.objects` has them."""


def bench(objects: Objects, seed: int, hidden_cps: float) -> str:
    """The text of a bench file."""
    return f"""\
name: drawn
mirror: {{model: triggerscope, port: "sim://triggerscope"}}
counter: {{model: tcspc488, usb: simulated}}
shutter: {{model: tcspc488}}
geometry: {{wall_distance_m: 2.0}}
simulation:
  seed: {seed}
  scene:
    hidden_cps: {hidden_cps:.1f}
    objects: {json.dumps(objects)}
"""


def picture_of(objects: Objects, wall: WallGrid) -> npt.NDArray[np.float64]:
    """What was drawn, (H, W) on the scanned wall's grid: the reflectance of every pixel, in m^2."""
    pieces = surfels([Surface.model_validate_json(json.dumps(each)) for each in objects], 0.001)
    col = np.floor((pieces.positions_m[:, 0] / wall.width_m + 0.5) * wall.cols).astype(int)
    row = np.floor((0.5 - pieces.positions_m[:, 1] / wall.height_m) * wall.rows).astype(int)
    inside = (row >= 0) & (row < wall.rows) & (col >= 0) & (col < wall.cols)
    total = np.zeros((wall.rows, wall.cols))
    np.add.at(total, (row[inside], col[inside]), pieces.reflectance_m2[inside])
    return total
