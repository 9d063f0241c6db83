"""Single objects without fine detail, as large as the wall: what is left of most things once they are small and far."""

from dataclasses import replace

import numpy as np

from nlos.acquisition.wall import WallGrid
from nlos.recon.training.kinds import CHARACTERS, Kind, Rng, bodies, small_turn
from nlos.recon.training.lettering import LETTER_FONTS, lettering
from nlos.recon.training.scenes import Scene
from nlos.recon.training.shapes import Canvas, Turned, blank_canvas, box, ellipsoid, panel, polyline, turned

WALL = WallGrid(2.0, 2.0, 128, 128)
BRIGHT, DEPTH = 0.8, 0.9
CENTRE = (0.0, 0.0, DEPTH)


def coarse_scene(rng: Rng) -> Scene:
    """One object in one shade, in the middle of the wall's raster."""
    canvas = blank_canvas(WALL.rows, WALL.cols)
    kind = COARSE[int(rng.choice(len(COARSE), p=SHARES))]
    kind(canvas, rng)
    present = np.isfinite(canvas.depth) & (canvas.coverage > 0)
    return Scene(
        kind.__name__,
        replace(WALL),
        np.where(present, canvas.depth, np.float32(np.inf)),
        canvas.normal * present,
        canvas.albedo * present,
        canvas.coverage * present,
    )


def _sheet(canvas: Canvas, rng: Rng, coverage: np.ndarray) -> None:
    panel(canvas, coverage.astype(np.float32), DEPTH, (rng.normal(0, 0.15), rng.normal(0, 0.15)), BRIGHT)


def letter(canvas: Canvas, rng: Rng) -> None:
    font, text = LETTER_FONTS[rng.integers(len(LETTER_FONTS))], CHARACTERS[rng.integers(len(CHARACTERS))]
    _sheet(canvas, rng, lettering(canvas, text, font, (0.0, 0.0), rng.uniform(0.5, 0.8), rng.normal(0, 0.1)))


def sheet(canvas: Canvas, rng: Rng) -> None:
    """A rectangle, or several that overlap: crosses, angles, arrows."""
    ink = np.zeros((canvas.y.size, canvas.x.size), bool)
    for k in range(int(rng.choice([1, 2, 3], p=[0.5, 0.3, 0.2]))):
        angle = rng.normal(0, 0.15) + (rng.integers(4) * np.pi / 4 if k else 0)
        wide, high = rng.uniform(0.12, 0.7, 2)
        dx, dy = (canvas.x[None] - k * rng.uniform(-0.3, 0.3)), (canvas.y[:, None] - k * rng.uniform(-0.3, 0.3))
        ink |= (np.abs(dx * np.cos(angle) + dy * np.sin(angle)) < wide) & (
            np.abs(dy * np.cos(angle) - dx * np.sin(angle)) < high
        )
    _sheet(canvas, rng, ink)


def ball(canvas: Canvas, rng: Rng) -> None:
    first = rng.uniform(0.3, 0.75)
    across = first * rng.uniform(0.5, 1.0, 2) if rng.random() < 0.5 else np.array([first, first])
    ellipsoid(canvas, CENTRE, (first, float(across[0]), float(across[1])), small_turn(rng), BRIGHT)


def case(canvas: Canvas, rng: Rng) -> None:
    half = rng.uniform(0.2, 0.6, 3)
    box(canvas, CENTRE, (float(half[0]), float(half[1]), float(half[2])), small_turn(rng, 0.7), BRIGHT)


def vase(canvas: Canvas, rng: Rng) -> None:
    radii = np.interp(np.linspace(0, 1, 40), np.linspace(0, 1, 5), rng.uniform(0.15, 0.5, 5))
    turned(canvas, CENTRE, Turned(radii, rng.uniform(1.0, 1.5), rng.normal(0, 0.4), rng.normal(0, 0.2)), BRIGHT)


def pipe(canvas: Canvas, rng: Rng) -> None:
    angles = np.cumsum(rng.normal(0, 0.9, 3)) + rng.uniform(0, 2 * np.pi)
    path = np.cumsum(np.stack((np.cos(angles), np.sin(angles), rng.normal(0, 0.2, 3)), axis=1), axis=0)
    path -= path.mean(axis=0)
    path *= 0.6 / np.abs(path[:, :2]).max()
    polyline(canvas, path + CENTRE, rng.uniform(0.12, 0.22), BRIGHT)


def figure(canvas: Canvas, rng: Rng) -> None:
    bodies(canvas, rng)


COARSE: tuple[Kind, ...] = (letter, sheet, ball, case, vase, pipe, figure)
SHARES = (0.28, 0.2, 0.14, 0.08, 0.1, 0.06, 0.14)
