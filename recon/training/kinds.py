"""The kinds of hidden scene that networks are trained on; each draws one into a canvas from a random generator."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from nlos.recon.training.lettering import LETTER_FONTS, lettering
from nlos.recon.training.shapes import (
    Array,
    Canvas,
    Turned,
    box,
    ellipsoid,
    height_field,
    panel,
    polyline,
    rotation_matrix,
    tube,
    turned,
)

Rng = np.random.Generator
Turn = npt.NDArray[np.float64]  # (3, 3)
Kind = Callable[[Canvas, Rng], None]
CHARACTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789abdefghkmnqrtuy"


def place(rng: Rng, size: tuple[float, float] = (0.35, 0.8)) -> tuple[float, float, float, float]:
    """Centre x, y, depth and half size of an object that lies mostly in front of the wall."""
    half = rng.uniform(*size)
    room = max(0.9 - half, 0.05)
    return rng.uniform(-room, room), rng.uniform(-room, room), rng.uniform(0.55, 1.25), half


def bright(rng: Rng) -> float:
    return float(rng.uniform(0.35, 1.0))


def small_turn(rng: Rng, most_rad: float = 0.6) -> Turn:
    return rotation_matrix(rng.uniform(-most_rad, most_rad), rng.uniform(-most_rad, most_rad), rng.normal(0, 0.15))


def smooth_noise(canvas: Canvas, rng: Rng, scale: float) -> Array:
    """A random field of unit variance and correlation length `scale` half-widths."""
    coarse = max(4, int(4 / scale))
    seed = rng.standard_normal((coarse, coarse))
    row = np.linspace(0, coarse - 1.001, canvas.y.size)
    col = np.linspace(0, coarse - 1.001, canvas.x.size)
    i, j = row.astype(int)[:, None], col.astype(int)[None, :]
    u, v = (row % 1)[:, None], (col % 1)[None, :]
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    field = (seed[i, j] * (1 - v) + seed[i, j + 1] * v) * (1 - u) + (
        seed[i + 1, j] * (1 - v) + seed[i + 1, j + 1] * v
    ) * u
    return np.asarray(field, dtype=np.float32)


def letters(canvas: Canvas, rng: Rng) -> None:
    """One to five letters in one font, on one sheet or each on its own, slanted."""
    count = int(rng.choice([1, 1, 2, 2, 3, 4, 5]))
    font = LETTER_FONTS[rng.integers(len(LETTER_FONTS))]
    half = rng.uniform(0.3, 0.75) / max(1.0, 0.55 * count)
    step = 1.9 * half * rng.uniform(0.75, 1.0)
    depth = rng.uniform(0.55, 1.25)
    one_sheet = rng.random() < 0.5
    slope = (rng.normal(0, 0.2), rng.normal(0, 0.15))
    x0, y0 = rng.uniform(-0.25, 0.25), rng.uniform(-0.4, 0.4)
    for k in range(count):
        text = CHARACTERS[rng.integers(len(CHARACTERS))]
        if not one_sheet:
            depth, slope = rng.uniform(0.55, 1.25), (rng.normal(0, 0.2), rng.normal(0, 0.15))
        ink = lettering(canvas, text, font, (x0 + (k - (count - 1) / 2) * step, y0), half, rng.normal(0, 0.1))
        panel(canvas, ink, depth, slope, bright(rng))


def wheel(canvas: Canvas, rng: Rng, centre: npt.NDArray[np.float64], radius: float, thick: float, turn: Turn) -> None:
    angle = np.linspace(0, 2 * np.pi, 23)
    rim = np.stack((radius * np.cos(angle), radius * np.sin(angle), 0 * angle), axis=1)
    albedo = bright(rng)
    polyline(canvas, centre + rim @ turn.T, thick, albedo)
    spokes = int(rng.choice([0, 3, 5, 8]))
    for k in range(spokes):
        a = 2 * np.pi * k / spokes
        polyline(
            canvas, np.stack((centre, centre + turn @ [radius * np.cos(a), radius * np.sin(a), 0])), thick / 2.5, albedo
        )


def boards(canvas: Canvas, rng: Rng) -> None:
    """Dark print on a bright board that fills a third to all of the view, slanted."""
    font = LETTER_FONTS[rng.integers(len(LETTER_FONTS))]
    wide, high = rng.uniform(0.55, 1.0, 2)
    x0, y0 = rng.uniform(-1, 1) * (1 - wide), rng.uniform(-1, 1) * (1 - high)
    count = int(rng.integers(1, 5))
    half = min(0.7 * high, 0.85 * wide / count) * rng.uniform(0.7, 1.0)
    ink = np.zeros((canvas.y.size, canvas.x.size), np.float32)
    for k in range(count):
        x, text = x0 + (k - (count - 1) / 2) * 2 * wide / count * 0.9, CHARACTERS[rng.integers(len(CHARACTERS))]
        ink = np.maximum(ink, lettering(canvas, text, font, (x, y0), half, rng.normal(0, 0.05)))
    board = (np.abs(canvas.x[None] - x0) < wide) & (np.abs(canvas.y[:, None] - y0) < high)
    paint = bright(rng) * (1 - rng.uniform(0.5, 1.0) * ink)
    slope = (rng.normal(0, 0.25), rng.normal(0, 0.2))
    panel(canvas, board.astype(np.float32), rng.uniform(0.6, 1.25), slope, np.maximum(paint, 0.02).astype(np.float32))


def cycles(canvas: Canvas, rng: Rng) -> None:
    """A bicycle or motorcycle: two wheels, a frame of tubes, handlebar, saddle, sometimes engine and tank."""
    x, y, z, half = place(rng, (0.5, 0.9))
    origin, turn = np.array([x, y, z]), small_turn(rng, 0.7)
    thick, radius = half * rng.uniform(0.03, 0.1), half * rng.uniform(0.3, 0.45)
    at = half * np.array(
        [[-0.6, -0.3, 0], [0.6, -0.3, 0], [-0.1, -0.3, 0], [-0.25, 0.25, 0], [0.4, 0.25, 0], [0.38, 0.42, 0.0]]
    )
    at += rng.normal(0, 0.05 * half, at.shape) * [1, 1, 0.3]
    back, front, pedals, saddle, head, bar = (origin + turn @ p for p in at)
    wheel(canvas, rng, back, radius, thick, turn)
    wheel(canvas, rng, front, radius * rng.uniform(0.8, 1.1), thick, turn)
    albedo = bright(rng)
    for a, b in ((back, pedals), (pedals, saddle), (saddle, head), (pedals, head), (back, saddle), (front, bar)):
        polyline(canvas, np.stack((a, b)), thick * 0.8, albedo)
    grip = turn @ [0.08 * half, 0.05 * half, rng.uniform(0.1, 0.3) * half]
    polyline(canvas, np.stack((bar - grip, bar + grip)), thick * 0.7, albedo)
    ellipsoid(canvas, tuple(saddle), (0.18 * half, 0.05 * half, 0.08 * half), turn, bright(rng))
    if rng.random() < 0.5:
        box(canvas, tuple(0.6 * pedals + 0.4 * head), (0.2 * half, 0.14 * half, 0.1 * half), turn, bright(rng))
        ellipsoid(canvas, tuple(0.5 * saddle + 0.5 * head), (0.28 * half, 0.1 * half, 0.12 * half), turn, bright(rng))


def tubes(canvas: Canvas, rng: Rng) -> None:
    """Bent pipes: random walks of straight pieces and arcs."""
    for _ in range(int(rng.integers(1, 4))):
        x, y, z, half = place(rng)
        pieces = int(rng.integers(3, 9))
        turns = np.cumsum(rng.normal(0, 0.9, pieces)) + rng.uniform(0, 2 * np.pi)
        steps = np.stack((np.cos(turns), np.sin(turns), rng.normal(0, 0.25, pieces)), axis=1)
        path = np.cumsum(steps, axis=0)
        path -= path.mean(axis=0)
        path *= half / np.abs(path[:, :2]).max()
        polyline(canvas, path * [1, 1, 0.5] + [x, y, z], half * rng.uniform(0.04, 0.16), bright(rng))


def vessels(canvas: Canvas, rng: Rng) -> None:
    """Bodies of revolution: vases, bottles, pins, bowls."""
    for _ in range(int(rng.choice([1, 1, 2, 3]))):
        x, y, z, half = place(rng)
        radii = np.interp(np.linspace(0, 1, 40), np.linspace(0, 1, 6), rng.uniform(0.1, 1.0, 6))
        radii = gaussian_filter(radii, rng.uniform(0.5, 4)) * half * rng.uniform(0.3, 0.7)
        turned(canvas, (x, y, z), Turned(radii, 2 * half, rng.normal(0, 0.5), rng.normal(0, 0.25)), bright(rng))


def bodies(canvas: Canvas, rng: Rng) -> None:
    """A standing figure or a bust: head, neck, torso, tapered limbs."""
    x, y, z, half = place(rng, (0.55, 0.9))
    bust = rng.random() < 0.4
    albedo, turn = bright(rng), small_turn(rng, 0.5)
    scale = half * (1.5 if bust else 0.9)

    def at(px: float, py: float, pz: float = 0.0) -> tuple[float, float, float]:
        p = turn @ (scale * np.array([px, py - (0.45 if bust else 0.0), pz]))
        return float(x + p[0]), float(y + p[1]), float(z + p[2])

    head = scale * rng.uniform(0.13, 0.2)
    ellipsoid(canvas, at(0, 0.85, -0.05), (0.8 * head, 1.1 * head, head), turn, albedo)
    ellipsoid(canvas, at(0, 0.8, -0.05 - 0.9 * head / scale), (0.12 * head, 0.3 * head, 0.25 * head), turn, albedo)
    tube(canvas, at(0, 0.55), at(0, 0.8), scale * 0.08, scale * 0.07, albedo)
    wide = rng.uniform(0.2, 0.32)
    ellipsoid(canvas, at(0, 0.3), (scale * wide, scale * 0.36, scale * 0.16), turn, bright(rng))
    for side in (-1, 1):
        shoulder = at(side * wide, 0.5)
        elbow = at(side * (wide + rng.uniform(0.0, 0.3)), rng.uniform(0.1, 0.6), rng.normal(0, 0.15))
        tube(canvas, shoulder, elbow, scale * 0.09, scale * 0.065, albedo)
        if bust:
            continue
        hand = at(side * (wide + rng.uniform(-0.1, 0.45)), rng.uniform(-0.1, 0.95), rng.normal(0, 0.2))
        tube(canvas, elbow, hand, scale * 0.065, scale * 0.04, albedo)
        knee = at(side * rng.uniform(0.1, 0.3), -0.45, rng.normal(-0.05, 0.1))
        tube(canvas, at(side * 0.12, 0.0), knee, scale * 0.12, scale * 0.08, albedo)
        tube(canvas, knee, at(side * rng.uniform(0.08, 0.4), -0.95), scale * 0.08, scale * 0.05, albedo)


def furniture(canvas: Canvas, rng: Rng) -> None:
    """Boxes: crates, steps, tables and chairs, all sharing one turn."""
    x, y, z, half = place(rng, (0.4, 0.9))
    turn, albedo = small_turn(rng, 0.5), bright(rng)
    if rng.random() < 0.5:
        turn = rotation_matrix(0, 0, 0)

    def part(centre: tuple[float, float, float], sides: tuple[float, float, float]) -> None:
        p = turn @ (half * np.array(centre)) + [x, y, z]
        box(canvas, (p[0], p[1], p[2]), (half * sides[0], half * sides[1], half * sides[2]), turn, albedo)

    match int(rng.integers(4)):
        case 0:
            for _ in range(int(rng.integers(1, 5))):
                sides = rng.uniform(0.15, 0.5, 3)
                part(tuple(rng.uniform(-0.6, 0.6, 3)), (sides[0], sides[1], 0.6 * sides[2]))
        case 1:
            steps = int(rng.integers(2, 6))
            rise, deep = 1.6 / steps, rng.uniform(0.08, 0.3)
            for k in range(steps):
                part((0, -0.8 + (k + 0.5) * rise, k * deep), (rng.uniform(0.85, 0.95), rise / 2, deep / 2))
        case 2:
            top, leg = rng.uniform(0.0, 0.5), rng.uniform(0.03, 0.09)
            part((0, top, 0), (0.9, rng.uniform(0.04, 0.12), 0.5))
            for side in (-0.8, 0.8):
                for deep in (-0.4, 0.4):
                    part((side, (top - 0.9) / 2, deep), (leg, (top + 0.9) / 2, leg))
        case _:
            seat, leg = rng.uniform(-0.3, 0.0), rng.uniform(0.03, 0.08)
            part((0, seat, 0), (0.45, 0.06, 0.4))
            part((0, seat + 0.55, 0.4), (0.45, rng.uniform(0.2, 0.5), 0.06))
            for side in (-0.38, 0.38):
                for deep in (-0.35, 0.35):
                    part((side, (seat - 0.95) / 2, deep), (leg, (seat + 0.95) / 2, leg))


def charts(canvas: Canvas, rng: Rng) -> None:
    """Slanted flat charts: checkers, bars, dots; cut out or painted."""
    x, y, z, half = place(rng, (0.35, 0.9))
    angle = rng.normal(0, 0.3)
    u = ((canvas.x[None, :] - x) * np.cos(angle) + (canvas.y[:, None] - y) * np.sin(angle)) / half
    v = (-(canvas.x[None, :] - x) * np.sin(angle) + (canvas.y[:, None] - y) * np.cos(angle)) / half
    inside = (np.abs(u) < 1) & (np.abs(v) < rng.uniform(0.5, 1.0))
    pitch = rng.uniform(0.15, 0.6)
    match int(rng.integers(4)):
        case 0:
            pattern = (np.floor(u / pitch) + np.floor(v / pitch)) % 2 > 0
        case 1:
            pattern = np.floor(u / (pitch * (1 + np.abs(np.floor(v * 2)) / 3))) % 2 > 0
        case 2:
            pattern = np.hypot(u / pitch % 1 - 0.5, v / pitch % 1 - 0.5) < rng.uniform(0.25, 0.45)
        case _:
            pattern = np.ones_like(inside)
    slope = (rng.normal(0, 0.35), rng.normal(0, 0.35))
    centre = z - slope[0] * x - slope[1] * y
    if rng.random() < 0.5:
        panel(canvas, (inside & pattern).astype(np.float32), centre, slope, bright(rng))
    else:
        paint = np.where(pattern, bright(rng), rng.uniform(0.05, 0.3)).astype(np.float32)
        panel(canvas, inside.astype(np.float32), centre, slope, paint)


def wires(canvas: Canvas, rng: Rng) -> None:
    """Thin wires: closed and open curves of a few harmonics."""
    for _ in range(int(rng.integers(1, 4))):
        x, y, z, half = place(rng, (0.4, 0.85))
        t = np.linspace(0, rng.choice([1.0, 0.7]) * 2 * np.pi, 40)
        curve = sum(
            rng.normal(0, 1 / k, (1, 3)) * np.cos(k * t)[:, None]
            + rng.normal(0, 1 / k, (1, 3)) * np.sin(k * t)[:, None]
            for k in (1, 2, 3)
        )
        curve = np.asarray(curve) * half / np.abs(curve).max()
        polyline(canvas, curve * [1, 1, 0.3] + [x, y, z], half * rng.uniform(0.012, 0.05), bright(rng))


def animals(canvas: Canvas, rng: Rng) -> None:
    """Rounded bodies grown together: ellipsoids merged into one lumpy surface, with ears or legs."""
    x, y, z, half = place(rng, (0.5, 0.85))
    parts = int(rng.integers(3, 7))
    depth = np.full_like(canvas.depth, np.inf)
    own = Canvas(canvas.x, canvas.y, depth, canvas.normal * 0, canvas.albedo * 0, canvas.coverage * 0)
    for k in range(parts):
        angle, reach = rng.uniform(0, 2 * np.pi), half * (rng.uniform(0.2, 0.6) if k else 0.0)
        centre = (x + reach * np.cos(angle), y + reach * np.sin(angle), z + half * rng.uniform(-0.2, 0.2))
        sides = half * rng.uniform(0.25, 0.6, 3) * (1.1 if k == 0 else 0.8)
        ellipsoid(own, centre, (sides[0], sides[1], sides[2]), small_turn(rng, 1.0), 1.0)
    present = np.isfinite(depth)
    if not present.any():
        return
    filled = np.where(present, depth, depth[present].max())
    lumps = smooth_noise(canvas, rng, half * rng.uniform(0.15, 0.5)) * half * rng.uniform(0.0, 0.05)
    smooth = gaussian_filter(filled, rng.uniform(0.5, 2.0)) + lumps
    albedo = bright(rng)
    height_field(canvas, np.where(present, smooth, np.inf).astype(np.float32), albedo)
    canvas.bodies.extend(replace(body, front_normal=None, albedo=albedo) for body in own.bodies)


TRAINED: dict[str, Kind] = {
    kind.__name__: kind for kind in (letters, cycles, tubes, vessels, bodies, furniture, charts, wires, animals)
}

BY_NAME: dict[str, Kind] = {"boards": boards}
"""Kinds that take part only where a training file names them, so that earlier files keep meaning the same scenes."""
