"""What the last picture of a film shows, taken as a body: how it moves the photons of the frames themselves tell.

The picture's points are rendered at every measured point, a diffuse confocal return each (O'Toole et al., Nature 2018),
moved along a path with a place for each frame's mean moment; the likeliest path is found by Fisher scoring, as counts
are Poisson's. A picture that is wrong about brightness, depth or the detector's response is wrong alike for every
frame, so that ways between frames hold. Parts of the body have a velocity of their own besides: what turns, or is two
bodies, is told by it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.acquisition.wall import WallGrid
from nlos.recon.over_time.moments import Moments
from nlos.recon.over_time.path import weights_along

Floats = npt.NDArray[np.float64]
Array = npt.NDArray[np.float32]

POINTS = 64
"""Of a body, at most."""
PARTS = 3
LEAST = 0.1
"""Of the brightest pixel: fainter ones are not the body's."""
MEASURED = 256
"""Points of a frame that are looked at, at most."""
FINE = 60
"""Times in a wall's longer side that a bin's length of way fits."""
ROUNDS, ROUNDS_APART, EXPECTED = 2, 2, 4
DARK = 1e-6
"""Counts a bin, at least."""
BENDS_M, NEAR_M, APART_M_PER_S, COMMON_M_PER_S = 0.01, 0.05, 1.0, 1e-3
"""Standard deviations that are expected: of how a path bends from frame to frame, of places from where they were
looked for, of a part's own velocity, and of all parts' together."""
FARTHEST_M = 0.05
"""In one round."""
ARRIVED_M = 1e-3
MARGIN_M = 0.15
"""Of ways, before and behind those of the body at the start, that each point's counts are looked at."""


@dataclass(frozen=True, eq=False)
class Body:
    """What a picture shows, in points as bright as each other or by their shares."""

    places_m: Floats  # (J, 3)
    shares: Floats  # (J,), 1 together
    part: npt.NDArray[np.intp]  # (J,), 0 to `PARTS` - 1
    moment_s: float


@dataclass(frozen=True, eq=False)
class Motion:
    """Of a body."""

    path_m: Floats  # (F, 3): where it is at each frame's mean moment, from where the picture shows it
    apart_m_per_s: float
    """How fast its parts move against each other, root mean square."""
    change: Floats  # (F,)
    """What share of its parts' light is not that of the last frame, root mean square."""


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


def motion_of(body: Body, frames: Sequence[Moments], start_m: Floats) -> Motion:
    """Of a body during two frames or more, in the order of time, sought near the path `start_m` (F, 3)."""
    seen, count, parts = _Seen(body, frames, start_m), len(frames), int(body.part.max()) + 1
    share = np.bincount(body.part, body.shares)
    bends = np.diff(np.eye(count), 2, axis=0)
    smooth, near = np.kron(bends.T @ bends / BENDS_M**2, np.eye(3)), np.eye(3 * count) / NEAR_M**2
    own = np.eye(3 * parts) / APART_M_PER_S**2 + np.kron(np.outer(share, share) / COMMON_M_PER_S**2, np.eye(3))
    prior, path = scipy.linalg.block_diag(smooth + near, own), slice(3 * count)
    path_m, together = start_m, np.zeros((parts, 3))
    for _ in range(ROUNDS):
        information, score = seen.scored(path_m, together)
        score[path] -= smooth @ path_m.ravel() + near @ (path_m - start_m).ravel()
        step = np.linalg.solve((information + prior)[path, path], score[path]).reshape(count, 3)
        path_m = path_m + np.clip(step, -FARTHEST_M, FARTHEST_M)
        if np.abs(step).max() < ARRIVED_M:
            break
    bent_m, apart = path_m, together
    for _ in range(ROUNDS_APART):
        information, score = seen.scored(bent_m, apart)
        score[path] -= smooth @ bent_m.ravel() + near @ (bent_m - start_m).ravel()
        score[3 * count :] -= own @ apart.ravel()
        step = np.linalg.solve(information + prior, score)
        bent_m, apart = bent_m + step[path].reshape(count, 3), apart + step[3 * count :].reshape(parts, 3)
    apart = apart - share @ apart
    doubt = np.linalg.inv(information + prior).diagonal()[3 * count :].reshape(parts, 3)
    apart_m2_per_s2 = max(float(share @ (apart**2 - doubt).sum(axis=1)), 0.0)
    bright = seen.brightness(path_m)
    bright = bright / np.maximum(bright.mean(axis=0), 1e-30)
    change = np.sqrt((bright - bright[-1]) ** 2 @ share)
    return Motion(path_m, float(np.sqrt(apart_m2_per_s2)), change)


class _Seen:
    """The photons of some frames, and what a body would have sent of them."""

    def __init__(self, body: Body, frames: Sequence[Moments], start_m: Floats) -> None:
        time, wall, self._parts = frames[0].time, frames[0].wall, int(body.part.max()) + 1
        wanted_s = max(wall.width_m, wall.height_m) / FINE / SPEED_OF_LIGHT_M_PER_S
        factor = max(1, round(wanted_s / time.bin_width_s))
        some = [np.arange(0, len(each.x_m), -(-len(each.x_m) // MEASURED)) for each in frames]
        self._x_m, self._y_m, taken_s = (
            np.concatenate([getattr(each, name)[one] for each, one in zip(frames, some, strict=True)])
            for name in ("x_m", "y_m", "taken_s")
        )
        self._body, self._bin_m = body, factor * time.bin_width_s * SPEED_OF_LIGHT_M_PER_S / 2
        self._frame = np.repeat(np.arange(len(frames)), [len(one) for one in some])
        self._along = weights_along(np.array([each.mean_s for each in frames]), taken_s)  # (N, F)
        self._since_s = taken_s - taken_s.mean()  # from the middle on, so that velocities do not mend the body's shape
        whole = time.bins // factor * factor
        counts = np.concatenate([each.counts[one, :whole] for each, one in zip(frames, some, strict=True)])
        counts = counts.reshape(len(counts), -1, factor).sum(axis=2, dtype=np.float32)
        zero_m = time.start_s * SPEED_OF_LIGHT_M_PER_S / 2
        ways_m = self._ways(start_m, np.zeros((self._parts, 3)))[0]
        first = (ways_m.min(axis=1) - MARGIN_M - zero_m) / self._bin_m
        lasts = int(np.ceil((np.ptp(ways_m, axis=1).max() + 2 * MARGIN_M) / self._bin_m))
        lasts = min(lasts, counts.shape[1])
        first = np.clip(first.astype(np.intp), 0, counts.shape[1] - lasts)[:, None]
        self._counts = np.take_along_axis(counts, first + np.arange(lasts), axis=1)
        self._start_m = zero_m + first * self._bin_m

    def scored(self, path_m: Floats, apart_m_per_s: Floats) -> tuple[Floats, Floats]:
        """Fisher's information and the score of the path and of velocities that the parts (P, 3) have besides."""
        arrivals, parts = self._arrivals(path_m, apart_m_per_s), self._parts
        expected, changes = self._expected(arrivals).sum(axis=1), self._changes(arrivals)
        gain, background = _gain_and_background(expected, self._counts)
        mean = np.float32(gain) * expected + np.float32(background)  # (N, T)
        changes *= np.float32(gain)
        score = (changes @ ((self._counts - mean) / mean)[..., None])[..., 0]  # (N, 3 parts)
        information = (changes / mean[:, None]) @ changes.swapaxes(1, 2)
        axes = np.tile(np.eye(3), (parts, 1))  # of all parts, those of the path
        by_path = np.einsum("nf,pa->npfa", self._along, axes).reshape(len(mean), 3 * parts, -1)
        by_parts = self._since_s[:, None, None] * np.eye(3 * parts)
        by = np.concatenate([by_path, by_parts], axis=2)  # (N, 3 parts, 3 F + 3 parts)
        flat = by.reshape(-1, by.shape[2])
        return flat.T @ (information @ by).reshape(flat.shape), flat.T @ score.ravel()

    def brightness(self, path_m: Floats) -> Floats:
        """Of each part in each frame (F, parts), 1 for what the picture says, in any unit: the likeliest, as
        `_gain_and_background`."""
        parts = self._expected(self._arrivals(path_m, np.zeros((self._parts, 3))))
        gain, background = _gain_and_background(parts.sum(axis=1), self._counts)
        frames = self._along.shape[1]
        light = np.stack([np.bincount(self._frame, each, frames) for each in parts.sum(axis=2).T], axis=1)
        bright = np.full(light.shape, gain)
        for _ in range(EXPECTED):
            mean = (parts * bright[self._frame][..., None].astype(np.float32)).sum(axis=1) + np.float32(background)
            over = (parts @ (self._counts / mean)[..., None])[..., 0]
            found = np.stack([np.bincount(self._frame, each, frames) for each in over.T], axis=1)
            bright *= found / np.maximum(light, 1e-30)
        return bright

    def _ways(self, path_m: Floats, apart_m_per_s: Floats) -> tuple[Array, Array]:
        """Lengths (N, J) of the ways to the body's points on its path, and their directions (3, N, J)."""
        displaced_m = (self._along @ path_m)[:, None]
        if apart_m_per_s.any():
            displaced_m = displaced_m + self._since_s[:, None, None] * apart_m_per_s[self._body.part]
        places_m = self._body.places_m + displaced_m
        x, y, z = np.moveaxis(places_m, -1, 0).astype(np.float32)
        x, y = x - self._x_m[:, None].astype(np.float32), y - self._y_m[:, None].astype(np.float32)
        long_m = np.sqrt(x * x + y * y + z * z)
        return long_m, np.stack([x, y, z]) / long_m

    def _arrivals(self, path_m: Floats, apart_m_per_s: Floats) -> "_Arrivals":
        """Of the light of every point of the body at every point of the wall, as far as it falls into the window."""
        bins = self._counts.shape[1]
        long_m, directions = self._ways(path_m, apart_m_per_s)
        place = (long_m - self._start_m) / self._bin_m - 0.5
        before = np.floor(place).astype(np.intp)
        on = (before >= 0) & (before < bins - 1)
        point, of = np.nonzero(on)
        light = (self._body.shares.astype(np.float32) * directions[2] ** 2 / long_m**4)[on]
        at = (point * self._parts + self._body.part[of]) * bins + before[on]
        return _Arrivals(at, (place - before)[on], light, directions[:, on])

    def _expected(self, seen: "_Arrivals") -> Array:
        """Light of each part (N, parts, T), in any unit."""
        points, bins = self._counts.shape
        size = points * self._parts * bins
        expected = np.bincount(seen.at, seen.light * (1 - seen.later), size)
        expected += np.bincount(seen.at + 1, seen.light * seen.later, size)
        return _blurred(expected.astype(np.float32).reshape(points, self._parts, bins))

    def _changes(self, seen: "_Arrivals") -> Array:
        """How that of each part changes as it moves, by metre: (N, 3 parts, T)."""
        points, bins = self._counts.shape
        changes = np.empty((points, self._parts, 3, bins), dtype=np.float32)
        for axis, direction in enumerate(seen.directions):
            moving = np.bincount(seen.at, seen.light * direction, points * self._parts * bins).astype(np.float32)
            changes[:, :, axis] = _moved_on(moving.reshape(points, self._parts, bins)) / np.float32(self._bin_m)
        return changes.reshape(points, self._parts * 3, bins)


@dataclass(frozen=True, eq=False)
class _Arrivals:
    """(K,) each: in which part's bin at which point, how far on towards the next, how much; and directions (3, K)."""

    at: npt.NDArray[np.intp]
    later: Array
    light: Array
    directions: Array


def _blurred(light: Array) -> Array:
    """By a bin: a surface between points, and the detector's response."""
    blurred = 0.5 * light
    blurred[..., 1:] += 0.25 * light[..., :-1]
    blurred[..., :-1] += 0.25 * light[..., 1:]
    return blurred


def _moved_on(light: Array) -> Array:
    """How light that is blurred so changes as it moves on by a bin."""
    change = -0.25 * light
    change[..., :-1] -= 0.25 * light[..., 1:]
    change[..., 1:] += 0.25 * light[..., :-1]
    change[..., 2:] += 0.25 * light[..., :-2]
    return change


def _gain_and_background(expected: Array, counts: Array) -> tuple[float, float]:
    """The likeliest ones, by rounds of expectation and maximisation (Shepp and Vardi, 1982)."""
    light, photons = max(float(expected.sum()), 1e-30), float(counts.sum(dtype=np.float64))
    gain, background = 0.7 * photons / light, 0.3 * photons / counts.size
    for _ in range(EXPECTED):
        background = max(background, DARK)
        over = counts / (gain * expected + background)
        gain, background = gain * float((over * expected).sum()) / light, background * float(over.mean())
    return gain, max(background, DARK)
