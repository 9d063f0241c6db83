"""The kinds kept for testing: one for every kind trained on, near to it and never shown."""

import numpy as np

from nlos.recon.training.kinds import Kind, Rng, bright, place, small_turn, smooth_noise
from nlos.recon.training.lettering import SIGN_FONTS, lettering
from nlos.recon.training.shapes import Canvas, Turned, box, ellipsoid, height_field, panel, polyline, tube, turned

SIGNS = "&%?@#§$£€¥ΔΣΩΨΞΦπλγ∂∇∫√∞⊕⊗→↑↔♣♠♥♦"


def signs(canvas: Canvas, rng: Rng) -> None:
    """Greek letters, currencies, arrows and other signs (for `letters`)."""
    count = int(rng.integers(1, 4))
    for k in range(count):
        half = rng.uniform(0.35, 0.7) / max(1.0, 0.6 * count)
        text, font = SIGNS[rng.integers(len(SIGNS))], SIGN_FONTS[rng.integers(len(SIGN_FONTS))]
        ink = lettering(canvas, text, font, ((k - (count - 1) / 2) * 1.9 * half, rng.uniform(-0.3, 0.3)), half, 0.0)
        panel(canvas, ink, rng.uniform(0.55, 1.25), (rng.normal(0, 0.2), rng.normal(0, 0.15)), bright(rng))


def ladders(canvas: Canvas, rng: Rng) -> None:
    """Ladders, trusses and tripods of straight rods (for `cycles`)."""
    x, y, z, half = place(rng, (0.5, 0.85))
    turn, thick, albedo = small_turn(rng, 0.7), half * rng.uniform(0.03, 0.09), bright(rng)
    rungs, wide = int(rng.integers(3, 7)), rng.uniform(0.2, 0.5)
    level = np.linspace(-0.9, 0.9, rungs)
    left = np.stack((-wide + 0 * level, level, 0 * level), axis=1) * half @ turn.T + [x, y, z]
    right = np.stack((wide + 0 * level, level, 0 * level), axis=1) * half @ turn.T + [x, y, z]
    polyline(canvas, left, thick, albedo)
    polyline(canvas, right, thick, albedo)
    crossed = rng.random() < 0.4
    for k in range(rungs - crossed):
        polyline(canvas, np.stack((left[k], right[k + crossed])), 0.7 * thick, albedo)


def springs(canvas: Canvas, rng: Rng) -> None:
    """Helices of thick wire (for `tubes`)."""
    x, y, z, half = place(rng, (0.4, 0.8))
    t = np.linspace(0, 1, 70)
    turns, wide = rng.uniform(2, 4), rng.uniform(0.25, 0.5)
    helix = np.stack(
        (wide * np.cos(2 * np.pi * turns * t), 1.8 * t - 0.9, 0.6 * wide * np.sin(2 * np.pi * turns * t)), axis=1
    )
    polyline(canvas, half * helix @ small_turn(rng, 0.8).T + [x, y, z], half * rng.uniform(0.04, 0.1), bright(rng))


def stacks(canvas: Canvas, rng: Rng) -> None:
    """Chess men and pagodas: discs, cones and balls on one axis (for `vessels`)."""
    x, y, z, half = place(rng, (0.45, 0.85))
    angle, albedo, bottom = rng.normal(0, 0.3), bright(rng), -half
    while bottom < 0.8 * half:
        height = half * rng.uniform(0.15, 0.5)
        radii = half * rng.uniform(0.15, 0.6) * np.linspace(1.0, rng.uniform(0.2, 1.0), 12)
        middle = bottom + height / 2
        centre = (x - np.sin(angle) * middle, y + np.cos(angle) * middle, z)
        turned(canvas, centre, Turned(radii, height, angle, 0.0), albedo)
        bottom += height
    ellipsoid(canvas, (x - np.sin(angle) * half, y + np.cos(angle) * half, z), (0.15, 0.15, 0.15), np.eye(3), albedo)


def hands(canvas: Canvas, rng: Rng) -> None:
    """A hand with its fingers spread (for `bodies`)."""
    x, y, z, half = place(rng, (0.55, 0.85))
    turn, albedo, mirror = small_turn(rng, 0.5), bright(rng), rng.choice([-1.0, 1.0])
    start = np.array([x, y, z])
    ellipsoid(canvas, (x, y - 0.25 * half, z), (0.33 * half, 0.38 * half, 0.14 * half), turn, albedo)
    for k, angle in enumerate((-0.95, -0.35, -0.05, 0.2, 0.5)):
        direction = np.array([mirror * np.sin(angle), np.cos(angle), rng.normal(0, 0.2)])
        knuckle = start + turn @ (
            half * (np.array([mirror * 0.3 * np.sin(1.6 * angle), 0, 0]) - [0, 0.05 + 0.2 * (k == 0), 0])
        )
        tip = knuckle + turn @ (half * rng.uniform(0.55, 0.75) * (0.75 if k == 0 else 1.0) * direction)
        tube(canvas, (*knuckle,), (*tip,), 0.09 * half, 0.06 * half, albedo)
    tube(canvas, (x, y - 0.5 * half, z), (x, y - half, z), 0.2 * half, 0.22 * half, albedo)


def shelves(canvas: Canvas, rng: Rng) -> None:
    """Shelves with things on them, and arches (for `furniture`)."""
    x, y, z, half = place(rng, (0.55, 0.9))
    turn, albedo = small_turn(rng, 0.35), bright(rng)
    boards, wide = int(rng.integers(2, 5)), rng.uniform(0.5, 0.9)

    def part(centre: tuple[float, float, float], sides: tuple[float, float, float], shade: float) -> None:
        p = turn @ (half * np.array(centre)) + [x, y, z]
        box(canvas, (p[0], p[1], p[2]), (half * sides[0], half * sides[1], half * sides[2]), turn, shade)

    for side in (-wide, wide):
        part((side, 0, 0), (0.05, 0.95, 0.2), albedo)
    for level in np.linspace(-0.9, 0.9, boards):
        part((0, level, 0), (wide, 0.04, 0.2), albedo)
        for _ in range(int(rng.integers(0, 3))):
            high = rng.uniform(0.08, 0.7 / boards)
            part((rng.uniform(-0.7, 0.7) * wide, level + high, 0), (rng.uniform(0.05, 0.2), high, 0.12), bright(rng))


def stars(canvas: Canvas, rng: Rng) -> None:
    """Siemens stars and concentric rings on slanted sheets (for `charts`)."""
    x, y, z, half = place(rng, (0.5, 0.9))
    dx, dy = (canvas.x[None, :] - x) / half, (canvas.y[:, None] - y) / half
    radius, angle = np.hypot(dx, dy), np.arctan2(dy, dx)
    if rng.random() < 0.6:
        pattern = np.sin(angle * rng.integers(4, 10) + rng.uniform(0, 6)) > 0
    else:
        pattern = np.sin(radius * rng.uniform(8, 20)) > 0
    slope = (rng.normal(0, 0.3), rng.normal(0, 0.3))
    panel(canvas, ((radius < 1) & pattern).astype(np.float32), z - slope[0] * x - slope[1] * y, slope, bright(rng))


def cages(canvas: Canvas, rng: Rng) -> None:
    """Wire-frame boxes and nets (for `wires`)."""
    x, y, z, half = place(rng, (0.4, 0.8))
    turn, thick, albedo = small_turn(rng, 0.9), half * rng.uniform(0.015, 0.05), bright(rng)
    corner = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-0.4, 0.4)]) * half * 0.8
    for a in range(8):
        for b in range(a + 1, 8):
            if np.count_nonzero(corner[a] != corner[b]) == 1:
                polyline(canvas, np.stack((corner[a], corner[b])) @ turn.T + [x, y, z], thick, albedo)


def rocks(canvas: Canvas, rng: Rng) -> None:
    """A faceted, ridged lump (for `animals`)."""
    x, y, z, half = place(rng, (0.45, 0.85))
    normals = rng.normal(0, 1, (14, 2))
    reach = half * rng.uniform(0.6, 1.0, 14)
    dx, dy = canvas.x[None, :] - x, canvas.y[:, None] - y
    facets = [(n[0] * dx + n[1] * dy) / r for n, r in zip(normals, reach, strict=True)]
    shape = np.max(facets, axis=0)
    ridges = np.abs(smooth_noise(canvas, rng, half * 0.4)) * half * rng.uniform(0.05, 0.2)
    depth = np.where(shape < 1, z + 0.4 * half * shape + ridges, np.inf)
    height_field(canvas, depth.astype(np.float32), bright(rng))


HELD_OUT: dict[str, Kind] = {
    kind.__name__: kind for kind in (signs, ladders, springs, stacks, hands, shelves, stars, cages, rocks)
}
