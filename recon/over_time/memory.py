"""A memory of the light of the last frames: brought to the newest one's moment along the way of what pictures show."""

from collections import deque
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.over_time.body import Motion, body_of, motion_of
from nlos.recon.over_time.body_light import Body
from nlos.recon.over_time.given import Given
from nlos.recon.over_time.half_grid import HalfGrid, on_half_grid
from nlos.recon.over_time.moments import Moments, added, moved
from nlos.recon.over_time.path import along, path_through
from nlos.recon.over_time.registration import Registration, Seen
from nlos.recon.volume import Reconstruction

Floats = npt.NDArray[np.float64]

FRAMES = 24
"""Held at most, and fewer where they would take more than `MOST_BYTES`."""
MOST_BYTES = 1 << 28
LAGS = 8
"""With how many frames before it each one is compared."""
FASTEST_M_PER_S = 3.0
LOOKS = 2
"""At every frame: the second time its own points are moved by the velocity that the first one found."""
SETTLED_M_PER_S = 0.1
LOOKED_AT = 4
"""Of so many successive frames, how far photons let two looks agree is found for the first: their mean counts."""
FORGOTTEN_S = 2.0
"""Light of what rests counts for a third after so long."""
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
FAINTEST = 0.1
"""Of the newest frame's weight: light that counts less is not carried along."""


class LightMemory:
    """Fed with frames in the order of time and with pictures made of them, gives each one's light with that of the
    frames before it, moved as what the last picture shows has moved. What turns or is several objects is not followed:
    the more parts of it move against each other, the less the light of earlier frames counts."""

    def __init__(self, wall: WallGrid, time: TimeAxis) -> None:
        self._registration = Registration(wall, time)
        self._held: deque[tuple[int, Moments, Seen]] = deque()
        self._pairs: dict[tuple[int, int], tuple[Floats, float]] = {}
        self._velocity_m_per_s = np.zeros(3)
        self._number = 0
        self._body: Body | None = None
        self._followed: Motion | None = None
        self._apart_m2_per_s2: float | None = None
        self.path_m = np.zeros((0, 3))
        """Where what is seen was at each frame held, from where it is now."""
        self.weights = np.zeros(0)
        """Of the light of each frame held, the newest one's being 1."""

    def add(self, frame: Moments) -> Transient:
        """The light at the mean moment of `frame`, the newest one."""
        self.watch(frame)
        return added(*self.light())

    def watch(self, frame: Moments) -> None:
        """Takes the newest frame, and finds how what is seen has moved."""
        path_m = self.path_m
        self._compare(frame)
        self._follow(path_m)
        self.weights = self._weights()

    def pictured(self, made: Reconstruction, moment_s: float | None = None) -> None:
        """A picture was made, of the newest frame or of the one of that mean moment: what it shows is followed from the
        next frame on. May be told in another thread."""
        moment_s = self._held[-1][1].mean_s if moment_s is None else moment_s
        self._body = body_of(made.albedo, made.depth_m, made.wall, moment_s)

    def light(self) -> tuple[list[Moments], list[float]]:
        """The light of each frame that counts, moved to where what it shows was at the mean moment of the newest one,
        which is the last, and how much it counts."""
        moments_s = np.array([held.mean_s for _, held, _ in self._held])
        depth_m = self._depth_m()
        brought = []
        for (number, held, _), weight in zip(self._held, self.weights, strict=True):
            if weight > 0:
                by_m = -along(self.path_m, moments_s, held.taken_s)
                brought.append((moved(held, by_m, depth_m, number), float(weight)))
        return [each for each, _ in brought], [weight for _, weight in brought]

    def given(self) -> Given:
        """What a network for films is told of the newest frame."""
        _, newest, seen = self._held[-1]
        photons = [float(held.counts.sum(dtype=np.float64)) for _, held, _ in self._held]
        return Given(
            partial(self._registration.volume_of, seen), seen.repeats, float(self.weights.sum()),
            (photons[-1], float(np.dot(photons, self.weights))), len(newest.x_m),
            np.array([held.mean_s for _, held, _ in self._held]), self.path_m,
        )  # fmt: skip

    def on_half_grid(self) -> HalfGrid:
        """The light on half the grid, and what a network for films is told of it."""
        return replace(on_half_grid(*self.light()), given=self.given())

    def _compare(self, frame: Moments) -> None:
        """Adds the frame, compares it with those before, and finds the path."""
        number, self._number = self._number, self._number + 1
        most = min(FRAMES, max(2, MOST_BYTES // max(frame.counts.nbytes, 1)))
        while len(self._held) >= most:
            self._held.popleft()
        earlier = list(self._held)
        repeats = earlier[-1][2].repeats if number % LOOKED_AT and earlier else None
        for _ in range(LOOKS):
            by_m = (frame.mean_s - frame.taken_s)[:, None] * self._velocity_m_per_s
            seen = self._registration.seen(moved(frame, by_m, self._depth_m(), number), repeats)
            repeats = seen.repeats
            self._held = deque([*earlier, (number, frame, seen)])
            for other, held, before in earlier[-LAGS:]:
                most_m = FASTEST_M_PER_S * abs(frame.mean_s - held.mean_s)
                self._pairs[other, number] = self._registration.displacement(before, seen, most_m)
            numbers = [each for each, _, _ in self._held]
            self._pairs = {pair: found for pair, found in self._pairs.items() if pair[0] >= numbers[0]}
            self.path_m = path_through(self._pairs, numbers)
            if len(earlier) < 2:
                break
            way_m, took_s = self.path_m[-1] - self.path_m[-3], frame.mean_s - earlier[-2][1].mean_s
            before_m_per_s, self._velocity_m_per_s = self._velocity_m_per_s, way_m / took_s
            if np.linalg.norm(self._velocity_m_per_s - before_m_per_s) < SETTLED_M_PER_S:
                break

    def _follow(self, before_m: Floats) -> None:
        """Betters the path that registering told by what the photons of the newest frames tell of the last picture's
        body; `before_m`, the path until the frame before."""
        frames = [held for _, held, _ in self._held][-FOLLOWED:]
        moments_s = np.array([held.mean_s for _, held, _ in self._held])
        count, body = len(frames), self._body_since(moments_s[-FOLLOWED:])
        if body is None:
            self._followed = self._apart_m2_per_s2 = None
            return
        start_m = self.path_m
        if count > 2:
            earlier = before_m[-len(start_m) + 1 :]
            start_m = np.concatenate([earlier, earlier[-1:] + start_m[-1] - start_m[-2]])
        start_m = start_m - along(start_m, moments_s, np.array([body.moment_s]))
        found = motion_of(body, frames, start_m[-count:])
        start_m[:-count] += found.path_m[0] - start_m[-count]
        start_m[-count:] = found.path_m
        self.path_m, self._followed = start_m - start_m[-1], found
        apart, before = found.apart_m_per_s**2, self._apart_m2_per_s2
        self._apart_m2_per_s2 = apart if before is None else before + STEADY * (apart - before)

    def _body_since(self, moments_s: Floats) -> Body | None:
        """What a picture of one of the frames of these moments showed; where there is none, what the volume of the last
        frame but one does; None where that is nothing, or the newest frame is the first."""
        if len(moments_s) < 2:
            return None
        if self._body is not None and moments_s[0] <= self._body.moment_s <= moments_s[-2]:
            return self._body
        _, frame, seen = self._held[-2]
        return body_of(*self._registration.front_of(seen), self._registration.wall, frame.mean_s)

    def _depth_m(self) -> float:
        """Of most of what is seen, now: the median over the frames held, each moved along the path."""
        if not self._held or len(self.path_m) != len(self._held):
            return self._held[-1][2].depth_m if self._held else 1.0
        return float(
            np.median([seen.depth_m - way for (_, _, seen), way in zip(self._held, self.path_m[:, 2], strict=True)])
        )

    def _weights(self) -> Floats:
        """Of each frame, 1 for the newest, as far as a picture's body could be followed through them: the less the
        older, the more its parts move against each other, and the more their brightness has changed."""
        moments_s = np.array([held.mean_s for _, held, _ in self._held])
        if self._followed is None or self._apart_m2_per_s2 is None:
            return np.where(moments_s == moments_s[-1], 1.0, 0.0)
        ages_s, ways_m = moments_s[-1] - moments_s, np.linalg.norm(self.path_m, axis=1)
        old = np.minimum(ways_m / REST_M, ages_s / MOVING_S) + ages_s / FORGOTTEN_S
        apart = self._apart_m2_per_s2 * (ages_s / BLUR_M) ** 2
        changed = np.full(len(ages_s), self._followed.change[0])
        changed[-len(self._followed.change) :] = self._followed.change
        weights = np.exp(-old - apart) / (1 + (changed / CHANGE) ** 2)
        return np.where(weights < FAINTEST, 0.0, weights)
