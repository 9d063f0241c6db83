"""The photons of frames, and what a body of some points would have sent of them along a path.

Each point is a diffuse surface that returns light confocally: (z / r)^2 / r^4 (O'Toole et al., Nature 2018).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.recon.over_time.moments import Moments
from nlos.recon.over_time.path import weights_along

Floats = npt.NDArray[np.float64]
Array = npt.NDArray[np.float32]

MEASURED = 256
"""Points of a frame that are looked at, at most."""
FINE = 60
"""Times in a wall's longer side that a bin's length of way fits."""
MARGIN_M = 0.15
"""Of ways, before and behind those of the body at the start, that each point's counts are looked at."""
EXPECTED = 4
"""Rounds of expectation and maximisation."""
DARK = 1e-6
"""Counts a bin, at least."""


@dataclass(frozen=True, eq=False)
class Body:
    """What a picture shows, in points as bright as each other or by their shares."""

    places_m: Floats  # (J, 3)
    shares: Floats  # (J,), 1 together
    part: npt.NDArray[np.intp]  # (J,), from 0 on
    moment_s: float


class BodyLight:
    """What a body would have sent of the photons of some frames, and how that changes as it moves."""

    def __init__(self, body: Body, frames: Sequence[Moments], start_m: Floats) -> None:
        time, wall, self.parts = frames[0].time, frames[0].wall, int(body.part.max()) + 1
        wanted_s = wall.longer_m / FINE / SPEED_OF_LIGHT_M_PER_S
        factor = min(max(1, round(wanted_s / time.bin_width_s)), time.bins)
        # drawn, since every n-th point of a grid may lie in a few of its columns
        some = [np.sort(np.random.default_rng(0).permutation(len(each.x_m))[:MEASURED]) for each in frames]
        self.x_m, self.y_m, taken_s = (
            np.concatenate([getattr(each, name)[one] for each, one in zip(frames, some, strict=True)])
            for name in ("x_m", "y_m", "taken_s")
        )
        self._body, self._bin_m = body, factor * time.bin_width_s * SPEED_OF_LIGHT_M_PER_S / 2
        self._frame = np.repeat(np.arange(len(frames)), [len(one) for one in some])
        self._along = weights_along(np.array([each.mean_s for each in frames]), taken_s)  # (N, F)
        self._since_s = (
            taken_s - taken_s.mean()
        )  # from the middle on, so that velocities do not correct the body's shape
        whole = time.bins // factor * factor
        counts = np.concatenate([each.counts[one, :whole] for each, one in zip(frames, some, strict=True)])
        counts = counts.reshape(len(counts), -1, factor).sum(axis=2, dtype=np.float32)
        zero_m = time.start_s * SPEED_OF_LIGHT_M_PER_S / 2
        ways_m = self._ways(start_m, np.zeros((self.parts, 3)))[0]
        first = (ways_m.min(axis=1) - MARGIN_M - zero_m) / self._bin_m
        lasts = int(np.ceil((np.ptp(ways_m, axis=1).max() + 2 * MARGIN_M) / self._bin_m))
        lasts = min(lasts, counts.shape[1])
        first = np.clip(first.astype(np.intp), 0, counts.shape[1] - lasts)[:, None]
        self._counts = np.take_along_axis(counts, first + np.arange(lasts), axis=1)
        self._start_m = zero_m + first * self._bin_m

    def scored(self, path_m: Floats, apart_m_per_s: Floats) -> tuple[Floats, Floats]:
        """Fisher's information and the score of the path and of velocities that the parts (P, 3) have besides."""
        arrivals, parts = self._arrivals(path_m, apart_m_per_s), self.parts
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
        """Of each part in each frame (F, parts), over what the picture says, in any unit: the likeliest, as
        `_gain_and_background`."""
        parts = self._expected(self._arrivals(path_m, np.zeros((self.parts, 3))))
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
        x, y = x - self.x_m[:, None].astype(np.float32), y - self.y_m[:, None].astype(np.float32)
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
        at = (point * self.parts + self._body.part[of]) * bins + before[on]
        return _Arrivals(at, (place - before)[on], light, directions[:, on])

    def _expected(self, seen: "_Arrivals") -> Array:
        """Light of each part (N, parts, T), in any unit."""
        points, bins = self._counts.shape
        size = points * self.parts * bins
        expected = np.bincount(seen.at, seen.light * (1 - seen.later), size)
        expected += np.bincount(seen.at + 1, seen.light * seen.later, size)
        return _blurred(expected.astype(np.float32).reshape(points, self.parts, bins))

    def _changes(self, seen: "_Arrivals") -> Array:
        """How that of each part changes as it moves, by metre: (N, 3 parts, T)."""
        points, bins = self._counts.shape
        changes = np.empty((points, self.parts, 3, bins), dtype=np.float32)
        for axis, direction in enumerate(seen.directions):
            moving = np.bincount(seen.at, seen.light * direction, points * self.parts * bins).astype(np.float32)
            changes[:, :, axis] = _moved_on(moving.reshape(points, self.parts, bins)) / np.float32(self._bin_m)
        return changes.reshape(points, self.parts * 3, bins)


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
