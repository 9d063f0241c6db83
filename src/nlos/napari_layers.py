"""Opens `reconstruction.h5` in napari (entry point `napari.manifest`): volume, front view, depth.

napari (0.5 or newer) is not needed to import this: layers are plain tuples of array, properties and kind, as npe2 asks
for.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nlos.recon.results import read_reconstruction
from nlos.recon.seen import visible_depth

AXES = ("z", "-y", "x")
Layer = tuple[Any, dict[str, Any], str]
"""(array, properties of the layer, kind)"""


def reader(path: str | Sequence[str]) -> Callable[[str], list[Layer]] | None:
    """What napari asks first: a function that reads this path, or None where it is no result of `nlos reconstruct`."""
    if not isinstance(path, str) or Path(path).name != "reconstruction.h5":
        return None
    return layers


def layers(path: str) -> list[Layer]:
    """Scaled in metres: z from the wall, then y, then x. napari's y grows downwards, as rows do: -y of the wall, and is
    labelled so.

    Raises `InvalidData` for a file that is none.
    """
    made = read_reconstruction(Path(path))
    wall, name = made.wall, made.method.upper()
    pitch_m = (wall.height_m / wall.rows, wall.width_m / wall.cols)
    corner_m = (-float(wall.y_m()[0]), float(wall.x_m()[0]))
    flat = {"scale": pitch_m, "translate": corner_m, "axis_labels": AXES[1:], "units": ("m", "m")}
    found: list[Layer] = [
        (made.albedo, {"name": f"{name} front view", "colormap": "gray", **flat}, "image"),
        (visible_depth(made), {"name": f"{name} depth (m)", "colormap": "viridis", "visible": False, **flat}, "image"),
    ]
    if made.volume is not None:
        depths_m = made.volume.depths_m
        step_m = float(np.mean(np.diff(depths_m))) if len(depths_m) > 1 else 1.0
        place = {
            "scale": (step_m, *pitch_m), "translate": (float(depths_m[0]), *corner_m), "axis_labels": AXES,
            "units": ("m", "m", "m"),
        }  # fmt: skip
        shown = {"name": f"{name} volume", "colormap": "magma", "rendering": "mip", "visible": False}
        found.append((made.volume.albedo, shown | place, "image"))
    return found
