"""A memory of the light of the last frames: brought to the newest one's moment, and weighted by how well it agrees."""

from collections import deque
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.over_time.given import Given
from nlos.recon.over_time.half_grid import HalfGrid, on_half_grid
from nlos.recon.over_time.moments import Moments, added, moved
from nlos.recon.over_time.path import along, path_through
from nlos.recon.over_time.registration import Registration, Seen

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
DISTRUST = 6.0
"""Of disagreement over photon noise: what is wrong with light that is not noise does not average out."""
SUREST = 0.98
"""Frames never agree better than that, however much light there is: points differ, and so does what they tell."""
FAINTEST = 0.1
"""Of the newest frame's weight: light that counts less is not carried along."""


class LightMemory:
    """Fed with frames in the order of time, gives each one's light with that of the frames before it, moved by the
    motion that registering their volumes tells. What several objects or turns do is not followed: the less a frame's
    volume agrees with the newest one's, the less its light counts."""

    def __init__(self, wall: WallGrid, time: TimeAxis) -> None:
        self._registration = Registration(wall, time)
        self._held: deque[tuple[int, Moments, Seen]] = deque()
        self._pairs: dict[tuple[int, int], tuple[Floats, float]] = {}
        self._velocity_m_per_s = np.zeros(3)
        self._number = 0
        self._at = -1
        """The place among the frames held of the one that is looked at: the newest."""
        self.path_m = np.zeros((0, 3))
        """Where what is seen was at each frame held, from where it is at the one looked at."""
        self.weights = np.zeros(0)
        """Of the light of each frame held, that one's being 1."""

    def add(self, frame: Moments) -> Transient:
        """The light at the mean moment of `frame`, the newest one."""
        self.watch(frame)
        return added(*self.light())

    def watch(self, frame: Moments) -> None:
        """Takes the newest frame, and finds how what is seen has moved."""
        self._compare(frame)
        self.weights = self._weights()

    def light(self) -> tuple[list[Moments], list[float]]:
        """The light of each frame that counts, moved to where what it shows was at the mean moment of the one looked
        at, and how much it counts."""
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
        photons = [held.photons for _, held, _ in self._held]
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

    def _depth_m(self) -> float:
        """Of most of what is seen at the frame looked at: the median over those held, each moved along the path."""
        if not self._held or len(self.path_m) != len(self._held):
            return self._held[-1][2].depth_m if self._held else 1.0
        return float(
            np.median([seen.depth_m - way for (_, _, seen), way in zip(self._held, self.path_m[:, 2], strict=True)])
        )

    def _weights(self) -> Floats:
        """Of each frame, 1 for the newest: photon noise over that and what its light is wrong by, which is how much
        less its volume agrees with the newest one's than two looks at one scene would. And the less the farther what is
        seen has moved since, as a path is never quite right."""
        *earlier, (_, frame, _) = self._held
        weights = np.ones(len(earlier) + 1)
        same = self._same()
        agrees = 0.0
        for place in reversed(range(len(earlier))):
            held = earlier[place][1]
            agrees = self._agreement(place, len(earlier)) if len(earlier) - place <= LAGS else agrees
            noise, error = 1 - same, DISTRUST * max(same - agrees, 0.0)
            way_m = float(np.linalg.norm(self.path_m[place]))
            age_s = frame.mean_s - held.mean_s
            weights[place] = noise / (noise + error) * np.exp(-way_m / self._registration.cell_m - age_s / FORGOTTEN_S)
        return np.where(weights < FAINTEST, 0.0, weights)

    def _agreement(self, before: int, now: int) -> float:
        """From 0 to 1, of two of the frames held, displaced as they are."""
        (one, _, first), (other, _, second) = self._held[before], self._held[now]
        height = self._pairs[one, other][1]
        return height / max(float(np.sqrt(first.energy * second.energy)), 1e-30)

    def _same(self) -> float:
        """How well two looks at one scene would agree: as far as photons allow, and as neighbouring frames do, but for
        what comes of the time between them."""
        count = len(self._held)
        apart = [
            float(np.median([self._agreement(k, k + lag) for k in range(count - lag)]))
            for lag in (1, 2, 3)
            if lag < count
        ]
        photons = min(float(np.mean([seen.repeats for _, _, seen in self._held])), SUREST)
        return min(photons, apart[0] + (apart[0] - apart[-1]) / 2) if apart else photons
