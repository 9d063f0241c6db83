"""A scene on disk put on a training's grid: points and bins added up, its truth averaged; nothing is stretched."""

from dataclasses import replace

import numpy as np

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.scenes_on_disk import SceneOnDisk
from nlos.recon.training.shapes import Array

SAME = 0.01
"""Walls this near to each other, relative to their width, are one."""


def on_grid(scene: SceneOnDisk, wall: WallGrid, time: TimeAxis) -> SceneOnDisk:
    """The scene as `wall` and `time` would have measured it. Raises ValueError naming what fits and what does not."""
    rows, cols = _factor(scene.wall.rows, wall.rows, "rows"), _factor(scene.wall.cols, wall.cols, "cols")
    for name, own, wanted in (
        ("wall_width_m", scene.wall.width_m, wall.width_m), ("height", scene.wall.height_m, wall.height_m)
    ):  # fmt: skip
        if abs(own - wanted) > SAME * wanted:
            raise ValueError(f"its wall is {scene.wall.width_m:g} x {scene.wall.height_m:g} m, and data has "
                             f"{wall.width_m:g} x {wall.height_m:g} m ({name})")  # fmt: skip
    light = _blocks(scene.light, rows, cols).sum(axis=(-3, -1))
    light = _rebinned(light, scene.time, time, scene.counted)
    covered = _mean(scene.coverage, rows, cols)
    weight = scene.coverage * (scene.depth_m > 0)
    depth_m = _mean(scene.depth_m * weight, rows, cols) / np.maximum(_mean(weight, rows, cols), 1e-6)
    return replace(
        scene,
        light=light,
        exposure=_mean(scene.exposure, rows, cols),
        intensity=_mean(scene.intensity, rows, cols),
        albedo=_mean(scene.albedo, rows, cols),
        depth_m=np.where(covered >= 0.5, depth_m, 0).astype(np.float32),
        coverage=covered,
        wall=wall,
        time=time,
    )


def _factor(own: int, wanted: int, key: str) -> int:
    if own % wanted:
        raise ValueError(f"it has {own} {key}, and data has {wanted}: only whole multiples can be added up")
    return own // wanted


def _blocks(x: Array, rows: int, cols: int) -> Array:
    """(..., H, W) as (..., H / rows, rows, W / cols, cols)."""
    return x.reshape(*x.shape[:-2], x.shape[-2] // rows, rows, x.shape[-1] // cols, cols)


def _mean(x: Array, rows: int, cols: int) -> Array:
    return np.asarray(_blocks(x, rows, cols).mean(axis=(-3, -1)), dtype=np.float32)


def _rebinned(light: Array, own: TimeAxis, wanted: TimeAxis, counted: bool) -> Array:
    """(T, H, W) in bins of another width, nothing lost; after the end of the scene's own time there is no light.

    Counts are added up whole; light without noise may be shared between two bins.
    """
    ratio = wanted.bin_width_s / own.bin_width_s
    whole = abs(ratio - round(ratio)) < 1e-3
    if ratio < 0.999 or (counted and not whole):
        why = "counts need a whole multiple" if counted else "narrower bins are not known"
        raise ValueError(
            f"its bins are {own.bin_width_s * 1e12:g} ps wide, and data has {wanted.bin_width_s * 1e12:g} ps: {why}"
        )
    reached_s = own.bins * own.bin_width_s
    if counted and reached_s < 0.999 * wanted.bins * wanted.bin_width_s:
        raise ValueError(f"its counts end after {reached_s * 1e9:g} ns, and data continues to "
                         f"{wanted.bins * wanted.bin_width_s * 1e9:g} ns: set fewer `bins`")  # fmt: skip
    if whole:
        factor = round(ratio)
        needed = wanted.bins * factor
        light = np.pad(light[:needed], ((0, max(0, needed - own.bins)), (0, 0), (0, 0)))
        return np.asarray(light.reshape(wanted.bins, factor, *light.shape[1:]).sum(axis=1), dtype=np.float32)
    before = np.concatenate((np.zeros_like(light[:1]), np.cumsum(light, axis=0, dtype=np.float64)))
    edges = np.minimum(np.arange(wanted.bins + 1) * ratio, own.bins)
    low = np.minimum(np.floor(edges).astype(np.int64), own.bins - 1)
    part = (edges - low)[:, None, None]
    return np.asarray(np.diff((1 - part) * before[low] + part * before[low + 1], axis=0), dtype=np.float32)
