"""A wall anywhere in a file's space, seen from the hidden scene's side: which way right and up are on it.

Files have walls in z = const (y-tal), and in y = const with z up (Zaragoza's NLOS dataset), their scene on either side.
"""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData

Array = npt.NDArray[np.float64]
_Y, _Z = np.eye(3)[1], np.eye(3)[2]
_FLAT, _SQUARE = 1e-3, 0.02


def on_wall(name: str, grid: Array, hints: list[Array]) -> tuple[Array, tuple[str, ...]]:
    """Places (A, B, 2) to the right and up, in metres from the grid's middle, of points (A, B, 3) on a plane, for who
    looks at it from the hidden scene, and what to say of it. `hints`: vectors from the wall to that side, the best one
    first; those along the wall say nothing.

    Raises `InvalidData`, naming the file, for points on no plane, no right angles, or with no side known.
    """
    middle = grid.reshape(-1, 3).mean(axis=0)
    one, other = grid[-1, 0] - grid[0, 0], grid[0, -1] - grid[0, 0]
    lengths = np.linalg.norm(one), np.linalg.norm(other)
    if not min(lengths) > 0 or abs(one @ other) > _SQUARE * lengths[0] * lengths[1]:
        raise InvalidData(f"{name}: its points are not a regular grid: rows and columns are at no right angle")
    normal = np.cross(one, other) / np.linalg.norm(np.cross(one, other))
    if np.abs((grid - middle) @ normal).max() > _FLAT:
        raise InvalidData(f"{name}: its points are not a regular grid in a plane")
    sides = [float(hint @ normal) for hint in hints if abs(hint @ normal) > _FLAT]
    if not sides and abs(normal @ _Z) < 0.9:
        raise InvalidData(
            f"{name}: its wall is not in a plane z = const, and nothing says on which side of it the scene is. Store "
            "where the sensor is, or the normals of its grid."
        )
    normal *= np.sign(sides[0]) if sides else np.sign(normal @ _Z)
    vertical, called = (_Y, "y") if abs(normal @ _Y) < 0.9 else (_Z, "z")
    axes = [one / lengths[0], other / lengths[1]]
    up = max(axes, key=lambda axis: abs(float(axis @ vertical)))
    up = up * np.sign(up @ vertical)
    right = np.cross(up, normal)
    notes = () if normal @ _Z > 0.9 else (f"the wall faces {_shown(normal)}: {called} is up, right is {_shown(right)}",)
    return np.stack([(grid - middle) @ right, (grid - middle) @ up], axis=2), notes


def _shown(direction: Array) -> str:
    """An axis by its name, else the vector."""
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > 0.999:
        return f"{'-' if direction[axis] < 0 else ''}{'xyz'[axis]}"
    return f"({direction[0]:.2f}, {direction[1]:.2f}, {direction[2]:.2f})"
