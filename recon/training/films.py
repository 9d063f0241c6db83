"""Endless films of hidden objects that move, from a seed: frames as they are scanned, and the truth at their moments.

Film i is the same whoever asks. Objects are scenes of the training side's own kinds made smaller, one or two of them,
on straight ways with turns between them; some rest, turn, appear or vanish. Photons are drawn as things are when their
points are lit, to within a fraction of a frame.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.frames import bayer
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.over_time.moments import Moments
from nlos.recon.training.coarse_scenes import coarse_scene
from nlos.recon.training.detector import pulse
from nlos.recon.training.scenes import Surfels, make_scene, surfels
from nlos.recon.training.shapes import Array, rotation_matrix

Floats = npt.NDArray[np.float64]
Rng = np.random.Generator

WALL, TIME = WallGrid(2.0, 2.0, 64, 64), TimeAxis(512, 32e-12)
DWELL_S, POINTS, SIDE = 0.4e-3, 256, 4
FRAME_S = POINTS * DWELL_S
MOMENTS = 8
"""Of a frame, at which things are looked at."""
SWEPT = 0.25
"""Share of films whose lines are swept: a point's light is that of the way from one point to the next."""
WAY = (-1 / 3, 0.0, 1 / 3)
"""Where on it, in ways."""
KINDS = ("letters", "boards", "bodies", "vessels", "animals", "furniture", "cycles", "tubes")
HELD_OUT = ("signs", "stacks", "hands", "rocks")
COARSE = 0.8
"""Share of objects that are `coarse_scene`s; the others are scenes that fill the wall, made smaller with their
details."""
LEAST_M, MOST_M = np.array([-0.6, -0.55, 0.55]), np.array([0.6, 0.55, 1.4])
LARGEST_SCALE = 0.8
"""Of scenes that are as large as the wall: smaller ones have more surfels a pixel."""
FINER = 8
"""Times as many for the truth, so that pixels do not depend on how many happen to lie in them."""
COUNTS = (0.7, 8.0)
"""Mean over points of their highest bin."""


@dataclass(frozen=True, eq=False)
class Body:
    """One object: its surfels about its own centre, and its path."""

    own: Surfels
    fine: Surfels
    """The same as more and smaller ones, for the truth's pixels."""
    at_s: Floats  # (K,)
    centre_m: Floats  # (K, 3)
    turned_rad: Floats  # (K, 3): pitch, yaw, roll
    there_s: tuple[float, float]

    def at(self, moment_s: float, fine: bool = False) -> Surfels | None:
        """Where it is then; None while it is not there."""
        own = self.fine if fine else self.own
        if not self.there_s[0] <= moment_s < self.there_s[1]:
            return None
        pitch, yaw, roll = (float(np.interp(moment_s, self.at_s, angle)) for angle in self.turned_rad.T)
        centre = np.array([np.interp(moment_s, self.at_s, along) for along in self.centre_m.T], dtype=np.float32)
        turn = np.asarray(rotation_matrix(yaw, pitch, roll), dtype=np.float32)
        return Surfels(own.position_m @ turn.T + centre, own.normal @ turn.T, own.weight_m2)


@dataclass(frozen=True)
class Truth:
    """The front view at one moment, 0 where nothing is."""

    intensity: Array  # (H, W) albedo times cosine times coverage
    depth_m: Array  # (H, W)


class TrainingFilm:
    """Film `index` of the sequence `seed`; `held_out` of the kinds that nothing is trained on."""

    def __init__(self, seed: int, index: int, frames: int, held_out: bool = False) -> None:
        rng = np.random.default_rng((seed, index, int(held_out), 5))
        self._seed = (seed, index, int(held_out))
        self.frames, self.objects = frames, 2 if rng.random() < 0.42 else 1
        lasts_s = frames * FRAME_S
        self.bodies = [
            _body(seed, 1000 * index + k, held_out, rng, lasts_s, 0.3 if self.objects == 2 else 0.12)
            for k in range(self.objects)
        ]
        self._same_points = rng.random() < 0.12
        self._swept = bool(np.random.default_rng((*self._seed, 8)).random() < SWEPT)
        fwhm_ps, tail = float(rng.uniform(30, 110)), float(rng.uniform(0, 0.15) * (rng.random() < 0.5))
        self._response = pulse(TIME, fwhm_ps, tail, float(rng.uniform(60, 200)))
        self._background = float(np.exp(rng.uniform(np.log(1e-5), np.log(0.02))))
        counts = float(np.exp(rng.uniform(*np.log(COUNTS))))
        middle = [replace(each, there_s=(-1.0, np.inf)).at(lasts_s / 2) for each in self.bodies]
        points = np.flatnonzero(_parts() == 0)
        peak = float(self._light([each for each in middle if each is not None], points).max(axis=1).mean())
        self._gain = counts / peak if peak > 0 else 0.0
        self._counts = counts

    def frame(self, number: int) -> Moments:
        """Every other one backwards."""
        part = 0 if self._same_points else number % SIDE**2
        points = np.flatnonzero(_parts() == part)[:: -1 if number % 2 else 1]
        taken_s = np.asarray(number * FRAME_S + (np.arange(POINTS) + 0.5) * DWELL_S, dtype=np.float64)
        each = POINTS // MOMENTS
        expected = np.concatenate(
            [
                self._light(self._at(float(taken_s[k : k + each].mean())), points[k : k + each])
                for k in range(0, POINTS, each)
            ]
        )
        rng = np.random.default_rng((*self._seed, 6, number))
        counts = rng.poisson(expected * self._gain + self._counts * self._background).astype(np.float32)
        row, col = np.divmod(points, WALL.cols)
        return Moments(WALL.x_m()[col], WALL.y_m()[row], counts, np.full(POINTS, DWELL_S), taken_s, WALL, TIME)

    def truth(self, at_s: float) -> Truth:
        """What a perfect picture shows at that moment."""
        intensity, depth_m = np.zeros(WALL.rows * WALL.cols), np.full(WALL.rows * WALL.cols, np.inf)
        area_m2 = WALL.width_m * WALL.height_m / (WALL.rows * WALL.cols)
        for each in self._at(at_s, True):
            col = np.floor((each.position_m[:, 0] / WALL.width_m + 0.5) * WALL.cols).astype(np.intp)
            row = np.floor((0.5 - each.position_m[:, 1] / WALL.height_m) * WALL.rows).astype(np.intp)
            seen = (col >= 0) & (col < WALL.cols) & (row >= 0) & (row < WALL.rows) & (each.normal[:, 2] < 0)
            pixel, light = (row * WALL.cols + col)[seen], (each.weight_m2 * each.normal[:, 2] ** 2)[seen] / area_m2
            sums = np.bincount(pixel, light, len(intensity))
            ways = np.bincount(pixel, light * each.position_m[seen, 2], len(intensity))
            own = np.where(sums > 0.03, ways / np.maximum(sums, 1e-12), np.inf)
            intensity, depth_m = intensity + sums, np.minimum(depth_m, own)
        shape = (WALL.rows, WALL.cols)
        depth_m = np.where(np.isfinite(depth_m), depth_m, 0.0)
        return Truth(intensity.reshape(shape).astype(np.float32), depth_m.reshape(shape).astype(np.float32))

    def _at(self, moment_s: float, fine: bool = False) -> list[Surfels]:
        return [now for each in self.bodies if (now := each.at(moment_s, fine)) is not None]

    def _light(self, there: list[Surfels], points: npt.NDArray[np.intp]) -> Floats:
        """(P, T), in arbitrary units."""
        row, col = np.divmod(points, WALL.cols)
        x_m, y_m = WALL.x_m()[col].astype(np.float32), WALL.y_m()[row].astype(np.float32)
        way_m = np.float32(SIDE * WALL.width_m / WALL.cols)
        ways = WAY if self._swept else (0.0,)
        made = [_light_at(there, x_m + np.float32(part) * way_m, y_m) for part in ways]
        return _blurred(np.mean(made, axis=0), self._response)


def _light_at(there: list[Surfels], x_m: Array, y_m: Array) -> Floats:
    """(P, T), of points of the wall (P,), as O'Toole et al. 2018, eq. 1, with both cosines."""
    bins_per_m = np.float32(2 / (SPEED_OF_LIGHT_M_PER_S * TIME.bin_width_s))
    made = np.zeros((len(x_m), TIME.bins + 1))
    base = (np.arange(len(x_m)) * (TIME.bins + 1))[:, None]
    for each in there:
        position, normal = each.position_m, each.normal
        dx, dy, z = x_m[:, None] - position[:, 0], y_m[:, None] - position[:, 1], position[:, 2]
        squared = dx * dx + dy * dy + z * z
        facing = np.maximum(dx * normal[:, 0] + dy * normal[:, 1] - z * normal[:, 2], 0)
        light = (facing * z / squared) ** 2 / squared**2 * each.weight_m2
        at = np.minimum((np.sqrt(squared) * bins_per_m).astype(np.intp), TIME.bins) + base
        made += np.bincount(at.ravel(), light.ravel(), made.size).reshape(made.shape)
    return made[:, : TIME.bins]


def _blurred(light: Floats, response: Floats) -> Floats:
    size = light.shape[1] + len(response)
    spectrum = np.fft.rfft(light, size) * np.fft.rfft(response, size)
    first = len(response) // 2
    return np.maximum(np.fft.irfft(spectrum, size)[:, first : first + light.shape[1]], 0.0)


def _parts() -> npt.NDArray[np.intp]:
    row, col = np.divmod(np.arange(WALL.rows * WALL.cols), WALL.cols)
    return np.asarray(bayer(SIDE)[row % SIDE, col % SIDE], dtype=np.intp)


def _body(seed: int, index: int, held_out: bool, rng: Rng, lasts_s: float, comes_or_goes: float) -> Body:
    kinds = HELD_OUT if held_out else KINDS
    coarse = not held_out and rng.random() < COARSE
    scene = coarse_scene(rng) if coarse else make_scene(seed, index, WALL, held_out=held_out, kinds=kinds)
    made = [surfels(scene, rng) for _ in range(1 + FINER)]
    centre = np.asarray(np.average(made[0].position_m, axis=0, weights=made[0].weight_m2), dtype=np.float64)
    reach_m = np.abs(made[0].position_m - centre)[:, :2].max(axis=1)
    wide_m = 2 * float(np.quantile(reach_m, 0.95)) + 0.02
    scale = min(float(rng.uniform(0.22, 1.0)) / wide_m, LARGEST_SCALE)
    bright = float(scale**2 * rng.uniform(0.6, 1.0) / max(float(scene.albedo.max()), 0.05))
    own = _smaller(made[:1], centre, scale, bright)
    fine = _smaller(made[1:], centre, scale, bright / FINER)
    at_s, centre_m, turned_rad = _path(rng, lasts_s)
    there_s = (-1.0, np.inf)
    if rng.random() < comes_or_goes:
        when_s = float(rng.uniform(0.25, 0.8)) * lasts_s
        there_s = (when_s, np.inf) if rng.random() < 0.5 else (-1.0, when_s)
    return Body(own, fine, at_s, centre_m, turned_rad, there_s)


def _smaller(made: list[Surfels], centre: Floats, scale: float, bright: float) -> Surfels:
    return Surfels(
        np.concatenate([(each.position_m - centre) * scale for each in made]).astype(np.float32),
        np.concatenate([each.normal for each in made]),
        np.concatenate([each.weight_m2 for each in made]) * np.float32(bright),
    )


def _path(rng: Rng, lasts_s: float) -> tuple[Floats, Floats, Floats]:
    """Moments (K,), places and turns (K, 3). It may begin between two turns."""
    manner, place = rng.random(), rng.uniform(LEAST_M, MOST_M)
    if manner < 0.08:
        return np.zeros(1), place[None], np.zeros((1, 3))
    speed = rng.uniform(0.05, 0.2) if manner < 0.16 else rng.uniform(0.2, 1.05)
    moments_s, places, turns = [-float(rng.uniform(0.0, 1.0))], [place], [np.zeros(3)]
    if rng.random() < 0.35:
        turns = [rng.normal(0, [0.1, 0.35, 0.25])]
    while moments_s[-1] < lasts_s:
        for _ in range(50):
            way = rng.normal(size=3) * [1, 1, 0.6]
            took_s = float(rng.uniform(0.5, 1.6))
            there = places[-1] + way / np.linalg.norm(way) * speed * took_s
            if ((there > LEAST_M) & (there < MOST_M)).all():
                break
        else:
            there = rng.uniform(LEAST_M, MOST_M)
            took_s = float(np.linalg.norm(there - places[-1])) / speed
        turned = turns[-1]
        if rng.random() < 0.4:
            turned = rng.normal(0, [0.12, 0.4, 0.3])
        moments_s, places, turns = [*moments_s, moments_s[-1] + took_s], [*places, there], [*turns, turned]
    return np.array(moments_s), np.array(places), np.array(turns)
