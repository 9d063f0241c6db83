"""Surfaces that send light to the wall but are not in the front view: sides, rears, and what is behind something."""

import numpy as np
import numpy.typing as npt

from nlos.recon.training.shapes import STEEPEST, Array, Body, Canvas

EVERY = 2
"""Raster cells a side that one piece of such a surface stands for,"""
FINE_BELOW = 0.5
"""except below this cosine: there it stands for its own cell, as most of the light comes from outlines."""
BEHIND = 0.02
"""How far behind the front view's surface another must lie to count as hidden, in half-widths of the wall."""
EDGE_ON = 0.03
"""Cosine below which a cell's surface counts as no larger."""
LEAST_CELLS = 9


def hidden_pieces(canvas: Canvas, texture: Array | float, nearest: float) -> tuple[Array, Array, Array]:
    """Places (S, 3), normals (S, 3) and albedo times area (S,), in half-widths of the wall.

    Surfaces that face no point of the wall, that lie within another body or that are nearer than `nearest` are left
    out. Whether other bodies block the light is decided by `visibility`.
    """
    made = [(k, pieces) for k, body in enumerate(canvas.bodies) if (pieces := _pieces(canvas, body)) is not None]
    if not made:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    pieces = np.concatenate([part for _, part in made])
    owner = np.repeat([k for k, _ in made], [len(part) for _, part in made])
    keep = (pieces[:, 2] > nearest) & _faces_wall(canvas, pieces)
    pieces, owner = pieces[keep], owner[keep]
    row, col = _cells(canvas, pieces)
    inside = (row >= 0) & (row < canvas.y.size) & (col >= 0) & (col < canvas.x.size)
    pieces, owner, row, col = pieces[inside], owner[inside], row[inside], col[inside]
    free = np.ones(len(pieces), bool)
    for k, body in enumerate(canvas.bodies):
        i, j = row - body.at[0].start, col - body.at[1].start
        at = np.flatnonzero(
            (i >= 0) & (i < body.front.shape[0]) & (j >= 0) & (j < body.front.shape[1]) & (owner != k) & free
        )
        z = pieces[at, 2]
        free[at[(body.front[i[at], j[at]] < z) & (z < body.rear[i[at], j[at]])]] = False
    shade = texture[row, col] if isinstance(texture, np.ndarray) else np.float32(texture)
    weight = (pieces[:, 6] * shade).astype(np.float32)
    return pieces[free, :3], pieces[free, 3:6], weight[free]


def _pieces(canvas: Canvas, body: Body) -> Array | None:
    """(K, 7): place, normal, albedo times area; None for what is too small."""
    present = np.isfinite(body.front)
    if np.count_nonzero(present) < LEAST_CELLS:
        return None
    parts = []
    if body.front_normal is not None:
        hidden = body.front > canvas.depth[body.at] + BEHIND
        edge = np.abs(body.front_normal[2]) < STEEPEST  # of this the front view's surfels are too small
        shown = np.where(hidden, np.float32(0), np.float32(1 / STEEPEST))
        parts.append(_raster(canvas, body, body.front, body.front_normal, present & (hidden | edge), shown))
    if body.rear_normal is not None:
        parts.append(_raster(canvas, body, body.rear, body.rear_normal, present, np.zeros(present.shape, np.float32)))
    if body.sides is not None:
        assert isinstance(body.albedo, float)
        parts.append(body.sides * np.array([1, 1, 1, 1, 1, 1, body.albedo], np.float32))
    return np.concatenate(parts) if parts else None


def _raster(
    canvas: Canvas, body: Body, depth: Array, normal: Array, chosen: npt.NDArray[np.bool_], shown: Array
) -> Array:
    """(K, 7) of the chosen cells, of one in a block where they are not steep; of the surface in each, `shown` times
    the cell's area is in the front view."""
    row, col = (np.arange(part.start, part.stop) % EVERY == 0 for part in body.at)
    steep = np.abs(normal[2]) < FINE_BELOW
    i, j = np.nonzero(chosen & (steep | row[:, None] & col[None]))
    cells = np.where(steep[i, j], 1, EVERY**2)
    surface = 1 / np.maximum(np.abs(normal[2, i, j]), EDGE_ON) - shown[i, j]
    albedo, coverage = (
        part[i, j] if isinstance(part, np.ndarray) else np.full(len(i), part, np.float32)
        for part in (body.albedo, body.coverage)
    )
    weight = albedo * coverage * cells * canvas.pitch**2 * surface
    place = (canvas.x[j + body.at[1].start], canvas.y[i + body.at[0].start], depth[i, j])
    return np.stack((*place, *normal[:, i, j], weight), axis=1).astype(np.float32)


def _faces_wall(canvas: Canvas, pieces: Array) -> npt.NDArray[np.bool_]:
    """Whether some point of the wall lies before a piece's face."""
    half = np.array([canvas.x[-1], canvas.y[0]]) + canvas.pitch / 2
    place, normal = pieces[:, :3], pieces[:, 3:6]
    best = np.abs(normal[:, :2]) @ half - (normal[:, :2] * place[:, :2]).sum(axis=1) - normal[:, 2] * place[:, 2]
    return np.asarray(best > 0)


def _cells(canvas: Canvas, pieces: Array) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Row and column of the raster, out of it where a piece is."""
    row = np.floor((canvas.y[0] - pieces[:, 1]) / canvas.pitch + 0.5).astype(np.int64)
    col = np.floor((pieces[:, 0] - canvas.x[0]) / canvas.pitch + 0.5).astype(np.int64)
    return row, col
