"""What the last picture of a film shows, taken as a body: how it moves the photons of the frames themselves tell.

The picture's points are rendered at every measured point, moved along a path with a place for each frame's mean moment;
the likeliest path is found by Fisher scoring, as counts are Poisson's. A picture that is wrong about brightness, depth
or the detector's response is wrong alike for every frame, so that ways between frames hold. Parts of the body have a
velocity of their own besides: what turns, or is two bodies, is told by it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.wall import WallGrid
from nlos.recon.over_time.body_light import Body, BodyLight
from nlos.recon.over_time.moments import Moments

Floats = npt.NDArray[np.float64]

POINTS = 64
"""Of a body, at most."""
PARTS = 3
LEAST = 0.1
"""Of the brightest pixel: fainter ones are not the body's."""
ROUNDS = 2
BENDS_M, NEAR_M, APART_M_PER_S, COMMON_M_PER_S = 0.01, 0.05, 1.0, 1e-3
"""Standard deviations that are expected: of how a path bends from frame to frame, of places from where they were
looked for, of a part's own velocity, and of all parts' together."""
FARTHEST_M = 0.05
"""In one round."""
ARRIVED_M = 1e-3


@dataclass(frozen=True, eq=False)
class Motion:
    """Of a body."""

    path_m: Floats  # (F, 3): where it is at each frame's mean moment, from where the picture shows it
    apart_m_per_s: float
    """How fast its parts move against each other, root mean square."""
    change: Floats  # (F,)
    """What share of its parts' light is not that of the frame looked at, root mean square."""


def body_of(
    albedo: npt.NDArray[np.floating], depth_m: npt.NDArray[np.floating], wall: WallGrid, moment_s: float
) -> Body | None:
    """Of a picture (H, W) of a film at that moment, its depths NaN where nothing is seen; None where nothing is."""
    row, col = np.nonzero(np.isfinite(depth_m) & (albedo > LEAST * albedo.max(initial=0.0)))
    if not len(row):
        return None
    light = albedo[row, col].astype(np.float64)
    places_m = np.stack([wall.x_m()[col], wall.y_m()[row], depth_m[row, col].astype(np.float64)], axis=1)
    if len(light) > POINTS:
        # as many points as bright as each other, spread over its light
        wanted = (np.arange(POINTS) + 0.5) / POINTS * light.sum()
        places_m, light = places_m[np.searchsorted(np.cumsum(light), wanted)], np.ones(POINTS)
    _, part = scipy.cluster.vq.kmeans2(places_m, min(PARTS, len(light)), minit="++", rng=0)
    return Body(places_m, light / light.sum(), np.unique(part, return_inverse=True)[1], moment_s)


def motion_of(body: Body, frames: Sequence[Moments], start_m: Floats, at: int = -1) -> Motion:
    """Of a body during two frames or more, in the order of time, sought near the path `start_m` (F, 3), its brightness
    held against that in frame `at`."""
    seen, share = BodyLight(body, frames, start_m), np.asarray(np.bincount(body.part, body.shares), np.float64)
    path_m = _likeliest_path(seen, start_m)
    bright = seen.brightness(path_m)
    bright = bright / np.maximum(bright.mean(axis=0), 1e-30)
    change = np.sqrt((bright - bright[at]) ** 2 @ share)
    return Motion(path_m, _speed_apart(seen, path_m, start_m, share), change)


def _likeliest_path(seen: BodyLight, start_m: Floats) -> Floats:
    """(F, 3): with all parts as one."""
    path_m, together, prior = start_m, np.zeros((seen.parts, 3)), _prior_of_path(len(start_m))
    path = slice(start_m.size)
    for _ in range(ROUNDS):
        information, score = seen.scored(path_m, together)
        pull = prior.bends @ path_m.ravel() + prior.near @ (path_m - start_m).ravel()
        step = np.linalg.solve(information[path, path] + prior.bends + prior.near, score[path] - pull)
        path_m = path_m + np.clip(step, -FARTHEST_M, FARTHEST_M).reshape(start_m.shape)
        if np.abs(step).max() < ARRIVED_M:
            break
    return path_m


def _speed_apart(seen: BodyLight, path_m: Floats, start_m: Floats, share: Floats) -> float:
    """Of parts with these shares of the body's light, see `Motion`: less what photons leave in doubt."""
    size, of_path = path_m.size, _prior_of_path(len(path_m))
    together = np.kron(np.outer(share, share), np.eye(3)) / COMMON_M_PER_S**2
    of_parts = np.eye(3 * seen.parts) / APART_M_PER_S**2 + together
    prior = scipy.linalg.block_diag(of_path.bends + of_path.near, of_parts)
    apart = np.zeros((seen.parts, 3))
    for _ in range(ROUNDS):
        information, score = seen.scored(path_m, apart)
        pull = of_path.bends @ path_m.ravel() + of_path.near @ (path_m - start_m).ravel()
        step = np.linalg.solve(information + prior, score - np.concatenate([pull, of_parts @ apart.ravel()]))
        path_m, apart = path_m + step[:size].reshape(path_m.shape), apart + step[size:].reshape(apart.shape)
    apart = apart - share @ apart
    doubt = np.linalg.inv(information + prior).diagonal()[size:].reshape(apart.shape)
    return float(np.sqrt(max(float(share @ (apart**2 - doubt).sum(axis=1)), 0.0)))


class _Prior(NamedTuple):
    """Information (3 F, 3 F) on a path that bends little, and lies near to where it is sought."""

    bends: Floats
    near: Floats


def _prior_of_path(frames: int) -> _Prior:
    twice: Floats = np.diff(np.eye(frames), 2, axis=0)
    bends = np.asarray(np.kron(twice.T @ twice, np.eye(3)), dtype=np.float64) / BENDS_M**2
    return _Prior(bends, np.eye(3 * frames) / NEAR_M**2)
