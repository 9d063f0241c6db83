"""A memory of light that follows what the last picture of a film shows by the photons of the frames themselves."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.over_time.body import Motion, body_of, motion_of
from nlos.recon.over_time.body_light import Body
from nlos.recon.over_time.memory import FAINTEST, FORGOTTEN_S, LightMemory
from nlos.recon.over_time.moments import Moments
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
FOLLOWED = 4
"""Newest frames that the body of a picture is followed through."""
STEADY = 0.5
"""Share of what is known of a body's parts that a frame renews."""


class FollowingMemory(LightMemory):
    """Told of the pictures that are made, it betters the path by what photons tell of how the last one's body moved:
    50 ms of a core a frame. What turns or is several objects is not followed: the more parts move against each other,
    the less the light of earlier frames counts."""

    def __init__(self, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__(wall, time)
        self._body: Body | None = None
        self._followed: Motion | None = None
        """Through the newest frames; how fast parts move apart is an average over them and those before."""

    def watch(self, frame: Moments) -> None:
        """Takes the newest frame, and finds how what is seen has moved."""
        path_m = self.path_m
        self._compare(frame)
        self._follow(path_m)
        self.weights = self._weights()

    def pictured(self, made: Reconstruction) -> None:
        """A picture of the newest frame was made: what it shows is followed from the next frame on."""
        self._body = body_of(made.albedo, made.depth_m, made.wall, self._held[-1][1].mean_s)

    def _follow(self, before_m: Floats) -> None:
        """Betters the path that registering told by what the photons of the newest frames tell of the last picture's
        body; `before_m`, the path until the frame before."""
        frames = [held for _, held, _ in self._held][-FOLLOWED:]
        moments_s = np.array([held.mean_s for _, held, _ in self._held])
        count, body = len(frames), self._body_since(moments_s[-FOLLOWED:])
        before, self._followed = self._followed, None
        if body is None:
            return
        start_m = self.path_m
        if count > 2:
            earlier = before_m[-len(start_m) + 1 :]
            start_m = np.concatenate([earlier, earlier[-1:] + start_m[-1] - start_m[-2]])
        start_m = start_m - along(start_m, moments_s, np.array([body.moment_s]))
        found = motion_of(body, frames, start_m[-count:])
        start_m[:-count] += found.path_m[0] - start_m[-count]
        start_m[-count:] = found.path_m
        self.path_m = start_m - start_m[-1]
        if before is not None:
            squared = STEADY * found.apart_m_per_s**2 + (1 - STEADY) * before.apart_m_per_s**2
            found = replace(found, apart_m_per_s=squared**0.5)
        self._followed = found

    def _body_since(self, moments_s: Floats) -> Body | None:
        """What a picture of one of the frames of these moments showed; where there is none, what the volume of the last
        frame but one does; None where that is nothing, or the newest frame is the first."""
        if len(moments_s) < 2:
            return None
        if self._body is not None and moments_s[0] <= self._body.moment_s <= moments_s[-2]:
            return self._body
        _, frame, seen = self._held[-2]
        return body_of(*self._registration.front_of(seen), self._registration.wall, frame.mean_s)

    def _weights(self) -> Floats:
        """Of each frame, 1 for the newest, as far as a picture's body could be followed through them: the less the
        older, the more its parts move against each other, and the more their brightness has changed."""
        moments_s = np.array([held.mean_s for _, held, _ in self._held])
        followed = self._followed
        if followed is None:
            return np.where(moments_s == moments_s[-1], 1.0, 0.0)
        ages_s, ways_m = moments_s[-1] - moments_s, np.linalg.norm(self.path_m, axis=1)
        old = np.minimum(ways_m / REST_M, ages_s / MOVING_S) + ages_s / FORGOTTEN_S
        apart = (followed.apart_m_per_s * ages_s / BLUR_M) ** 2
        older = len(ages_s) - len(followed.change)
        changed = np.pad(followed.change, (older, 0), "edge")
        weights = np.exp(-old - apart) / (1 + (changed / CHANGE) ** 2)
        return np.where(weights < FAINTEST, 0.0, weights)
