"""A memory of light that follows what the last picture of a film shows by the photons of the frames themselves."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.over_time.body import Motion, body_of, motion_of
from nlos.recon.over_time.body_light import Body
from nlos.recon.over_time.memory import FAINTEST, FORGOTTEN_S, LightMemory
from nlos.recon.over_time.moments import Moments, added
from nlos.recon.over_time.path import along
from nlos.recon.volume import Reconstruction

Floats = npt.NDArray[np.float64]

MOVING_S = 0.15
"""Light of what moves, and so may turn, counts for a third after so long, unless it has gone less far than `REST_M`."""
REST_M = 0.03
BLUR_M = 0.014
"""So far parts may have moved against each other until light counts for a third."""
CHANGE = 0.3
"""Light counts half where the body's parts are on average so much brighter or darker."""
BEFORE, AFTER = 2, 1
"""Frames before and after one that a body is followed through. With two after it, velocities of two bodies average
out."""
STEADY = 0.5
"""Share of what is known of a body's parts that a frame renews."""


class FollowingMemory(LightMemory):
    """Fed with frames and told of the pictures that are made, it betters the path by what photons tell of how the last
    one's body moved: 50 ms of a core a frame. A frame's light is brought together once the frame after it is there, and
    holds that one's too. What turns or is several objects is not followed: the more parts move against each other, the
    less the light of other frames counts."""

    def __init__(self, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__(wall, time)
        self._body: Body | None = None
        self._followed: Motion | None = None
        """Through the frames around one; how fast parts move apart is an average over them and those before."""

    def each_brought(self, frames: Iterable[Moments]) -> Iterator[Transient]:
        """The light of each frame at its mean moment, once the one after it is there: tell `pictured` before the next
        is asked for."""
        number = -1
        for number, frame in enumerate(frames):
            self.watch(frame)
            if number:
                yield added(*self.light())
        if number >= 0:
            self._look_at(len(self.path_m) - 1)
            yield added(*self.light())

    def watch(self, frame: Moments) -> None:
        """Takes the newest frame, and turns to the one before it."""
        before_m = self.path_m
        self._compare(frame)
        count = len(self.path_m)
        if count > 2:
            earlier_m = before_m[-count + 1 :]
            self.path_m = np.concatenate([earlier_m, earlier_m[-1:] + self.path_m[-1] - self.path_m[-2]])
        self._look_at(max(count - 2, 0))

    def pictured(self, made: Reconstruction) -> None:
        """A picture of that light was made: what it shows is followed through the frames around it."""
        self._body = body_of(made.albedo, made.depth_m, made.wall, self._held[self._at][1].mean_s)

    def _look_at(self, at: int) -> None:
        """Turns to a frame held: betters the path by what the photons of frames around it tell of the last picture's
        body, and finds how much the light of each one counts."""
        self._at = at
        moments_s = np.array([held.mean_s for _, held, _ in self._held])
        around = slice(max(at - BEFORE, 0), at + AFTER + 1)
        frames = [held for _, held, _ in self._held][around]
        body, start_m = self._body_in(frames), self.path_m
        before, self._followed = self._followed, None
        if body is not None:
            start_m = start_m - along(start_m, moments_s, np.array([body.moment_s]))
            found = motion_of(body, frames, start_m[around], at - around.start)
            first, stop = around.start, around.start + len(frames)
            start_m[:first] += found.path_m[0] - start_m[first]
            start_m[stop:] += found.path_m[-1] - start_m[stop - 1]
            start_m[around] = found.path_m
            if before is not None:
                squared = STEADY * found.apart_m_per_s**2 + (1 - STEADY) * before.apart_m_per_s**2
                found = replace(found, apart_m_per_s=squared**0.5)
            self._followed = found
        self.path_m = start_m - start_m[at]
        self.weights = self._weights()

    def _body_in(self, frames: list[Moments]) -> Body | None:
        """What a picture of one of these frames showed; where there is none, what the volume of the frame next to the
        one looked at does; None where that is nothing, or there is one frame only."""
        if len(frames) < 2:
            return None
        if self._body is not None and frames[0].mean_s <= self._body.moment_s <= frames[-1].mean_s:
            return self._body
        _, frame, seen = self._held[self._at - 1 if self._at else 1]
        return body_of(*self._registration.front_of(seen), self._registration.wall, frame.mean_s)

    def _weights(self) -> Floats:
        """Of each frame, 1 for the one looked at, as far as a body could be followed through them: the less the older
        or newer, the more its parts move against each other, and the more their brightness has changed."""
        moments_s, followed = np.array([held.mean_s for _, held, _ in self._held]), self._followed
        ages_s, ways_m = np.abs(moments_s - moments_s[self._at]), np.linalg.norm(self.path_m, axis=1)
        if followed is None:
            return np.where(ages_s == 0, 1.0, 0.0)
        old = np.minimum(ways_m / REST_M, ages_s / MOVING_S) + ages_s / FORGOTTEN_S
        apart = (followed.apart_m_per_s * ages_s / BLUR_M) ** 2
        first = max(self._at - BEFORE, 0)
        changed = np.pad(followed.change, (first, len(ages_s) - first - len(followed.change)), "edge")
        weights = np.exp(-old - apart) / (1 + (changed / CHANGE) ** 2)
        return np.where(weights < FAINTEST, 0.0, weights)
