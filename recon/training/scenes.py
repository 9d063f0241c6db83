"""Endless hidden scenes from a seed: front view, albedo, depth, normals and mask, and the surfels light reaches."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.wall import WallGrid
from nlos.recon.training.held_out_kinds import HELD_OUT
from nlos.recon.training.kinds import BY_NAME, TRAINED, Rng, smooth_noise
from nlos.recon.training.shapes import STEEPEST, Array, Canvas, blank_canvas
from nlos.recon.training.solids import hidden_pieces

GENERATOR = 1
"""Goes up whenever the same (seed, index) begins to mean another scene: caches made before are then not used."""
OVERSAMPLING = 2
NEAREST = 0.25


@dataclass(frozen=True)
class Surfels:
    """Small flat pieces of surface."""

    position_m: Array  # (S, 3)
    normal: Array  # (S, 3)
    weight_m2: Array  # (S,) albedo times area


@dataclass(frozen=True)
class Scene:
    """The surface that faces the wall, seen from it orthographically, on a raster finer than the scan grid.

    Lengths in metres; `depth_m` is inf and everything else 0 where nothing is.
    """

    kind: str
    wall: WallGrid  # its rows and cols are the raster's
    depth_m: Array  # (M, N)
    normal: Array  # (3, M, N), unit, towards the wall (z below 0)
    albedo: Array  # (M, N)
    coverage: Array  # (M, N), share of the raster cell that is covered
    hidden: Surfels | None = None
    """What sends light and is not in the front view, where that was asked for."""


@dataclass(frozen=True)
class FrontView:
    """What a perfect reconstruction shows, on the scan grid; 0 where nothing is."""

    intensity: Array  # (H, W) albedo |cos| times coverage
    albedo: Array  # (H, W) mean over the covered part
    depth_m: Array  # (H, W) median over the covered part, where at least half is covered
    normal: Array  # (3, H, W)
    coverage: Array  # (H, W)
    mask: npt.NDArray[np.bool_]  # (H, W) coverage of a half and more


def make_scene(
    seed: int,
    index: int,
    grid: WallGrid,
    *,
    held_out: bool = False,
    kinds: tuple[str, ...] = (),
    solid: bool = False,
) -> Scene:
    """Scene number `index` of the sequence `seed`: the same whoever asks, in whatever order.

    `kinds` limits it to some of `kind_names(held_out)`. The raster has OVERSAMPLING cells per point of `grid`. `solid`
    bodies have sides and rears, which light reaches from beside the front view.
    Raises ValueError for a kind that is not in the family.
    """
    family = HELD_OUT if held_out else TRAINED | BY_NAME
    names = kinds or kind_names(held_out)
    if unknown := sorted(set(names) - set(family)):
        raise ValueError(f"no such kind of scene: {', '.join(unknown)}. There are: {', '.join(family)}.")
    rng = np.random.default_rng((seed, index, int(held_out)))
    unit = min(grid.width_m, grid.height_m) / 2
    raster = replace(grid, rows=OVERSAMPLING * grid.rows, cols=OVERSAMPLING * grid.cols)
    while True:
        canvas = blank_canvas(raster.rows, raster.cols, grid.width_m / grid.height_m)
        count = int(rng.choice([1, 2, 3], p=[0.75, 0.18, 0.07]))
        drawn = [names[rng.integers(len(names))] for _ in range(count)]
        for name in drawn:
            family[name](canvas, rng)
        texture = _paint(canvas, rng)
        canvas.coverage[~(canvas.depth > NEAREST)] = 0
        canvas.coverage[~np.isfinite(canvas.depth)] = 0
        if canvas.coverage.mean() > 0.005:
            break
    present = canvas.coverage > 0
    return Scene(
        kind="+".join(drawn),
        wall=raster,
        depth_m=np.where(present, canvas.depth * np.float32(unit), np.float32(np.inf)),
        normal=canvas.normal * present,
        albedo=canvas.albedo * present,
        coverage=canvas.coverage,
        hidden=_hidden(canvas, texture, unit) if solid else None,
    )


def _hidden(canvas: Canvas, texture: Array | float, unit_m: float) -> Surfels:
    place, normal, weight = hidden_pieces(canvas, texture, NEAREST)
    return Surfels(place * np.float32(unit_m), normal, weight * np.float32(unit_m**2))


def kind_names(held_out: bool = False) -> tuple[str, ...]:
    """The kinds that are drawn from unless some are named."""
    return tuple(HELD_OUT if held_out else TRAINED)


def kinds_to_name(held_out: bool = False) -> tuple[str, ...]:
    """The kinds that may be named."""
    return kind_names(held_out) + (() if held_out else tuple(BY_NAME))


def _paint(canvas: Canvas, rng: Rng) -> Array | float:
    """Texture: none (six of ten scenes), blotches, or stripes. Returns what the albedo was multiplied by, above 0."""
    choice = rng.random()
    if choice < 0.6:
        return 1.0
    if choice < 0.85:
        texture = 1 + rng.uniform(0.2, 0.6) * smooth_noise(canvas, rng, rng.uniform(0.08, 0.5))
    else:
        angle, pitch = rng.uniform(0, np.pi), rng.uniform(0.1, 0.5)
        phase = (canvas.x[None, :] * np.cos(angle) + canvas.y[:, None] * np.sin(angle)) / pitch
        texture = 1 - rng.uniform(0.3, 0.9) * (phase % 1 > 0.5)
    np.clip(canvas.albedo * texture, 0.03, 1.0, out=canvas.albedo)
    return np.asarray(np.maximum(texture, 0.03), dtype=np.float32)


def front_view(scene: Scene, grid: WallGrid) -> FrontView:
    """The truth on `grid`, whose pixels must be whole blocks of the scene's raster (else ValueError)."""
    rows, cols = scene.depth_m.shape
    if rows % grid.rows or cols % grid.cols:
        raise ValueError(f"a raster of {rows} x {cols} does not divide into a grid of {grid.rows} x {grid.cols}")
    shape = (grid.rows, rows // grid.rows, grid.cols, cols // grid.cols)

    def blocks(field: Array) -> Array:
        return field.reshape(shape).transpose(0, 2, 1, 3).reshape(grid.rows, grid.cols, -1)

    cover = blocks(scene.coverage)
    total = cover.sum(axis=-1)
    weight = cover / np.maximum(total, 1e-9)[..., None]
    mask = total >= 0.5 * cover.shape[-1]
    depth = blocks(np.where(scene.coverage > 0, scene.depth_m, np.float32(np.nan)))
    median = np.zeros(grid.rows * grid.cols, np.float32)
    chosen = mask.ravel()
    median[chosen] = np.nanmedian(depth.reshape(median.size, -1)[chosen], axis=1)
    normal = np.stack([(blocks(part) * weight).sum(axis=-1) for part in scene.normal])
    normal /= np.maximum(np.linalg.norm(normal, axis=0), 1e-9)
    return FrontView(
        intensity=(blocks(scene.albedo * np.abs(scene.normal[2])) * cover).mean(axis=-1),
        albedo=(blocks(scene.albedo) * weight).sum(axis=-1),
        depth_m=median.reshape(mask.shape),
        normal=normal * (total > 0),
        coverage=total / cover.shape[-1],
        mask=mask,
    )


def surfels(scene: Scene, rng: Rng) -> Surfels:
    """One surfel for every covered raster cell, at a random place in it, moved along the surface's own slope; and what
    the scene has hidden from the front view."""
    row, col = np.nonzero(scene.coverage > 0)
    pitch_x, pitch_y = scene.wall.width_m / scene.wall.cols, scene.wall.height_m / scene.wall.rows
    normal = scene.normal[:, row, col]
    facing = np.maximum(-normal[2], STEEPEST)
    dx = rng.uniform(-0.5, 0.5, row.size).astype(np.float32) * pitch_x
    dy = rng.uniform(-0.5, 0.5, row.size).astype(np.float32) * pitch_y
    x, y = scene.wall.x_m().astype(np.float32), scene.wall.y_m().astype(np.float32)
    z = scene.depth_m[row, col] + (normal[0] * dx + normal[1] * dy) / facing
    area = pitch_x * pitch_y * scene.coverage[row, col] / facing
    shown = Surfels(
        position_m=np.stack((x[col] + dx, y[row] + dy, z), axis=1).astype(np.float32),
        normal=np.ascontiguousarray(normal.T),
        weight_m2=(scene.albedo[row, col] * area).astype(np.float32),
    )
    if scene.hidden is None:
        return shown
    parts = zip(_arrays(shown), _arrays(scene.hidden), strict=True)
    return Surfels(*(np.concatenate(both) for both in parts))


def _arrays(pieces: Surfels) -> tuple[Array, Array, Array]:
    return pieces.position_m, pieces.normal, pieces.weight_m2
