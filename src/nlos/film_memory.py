"""The light that pictures of a film are made of with a memory: a frame's own, and that of others moved along."""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.response import Response
from nlos.acquisition.transient import Transient
from nlos.recon.over_time.following import FollowingMemory
from nlos.recon.over_time.moments import Moments, moments_of
from nlos.recon.volume import Reconstruction


class FilmMemory:
    """Fed with the calibrated frames of one recording, in the order of time, and told all of them as one scan: what its
    points have behind their direct light is looked at. Raises `InvalidData` for free positions, whose light has no
    place on the grid until it is moved."""

    def __init__(self, recording: Recording, whole: Transient) -> None:
        if not recording.on_grid:
            raise InvalidData(f"{recording.path}: its points are off the grid; --memory moves light along a grid")
        self._plan, self._records = recording.plan, recording.intact_records()
        self._bins = whole.time.bins
        self._memory: FollowingMemory | None = None
        self._frames: list[float] = []

    @property
    def frames_to_a_picture(self) -> int:
        """How many frames' light a picture holds, on average: neighbouring ones share it."""
        return round(float(np.mean(self._frames or [1.0])))

    def brought(self, frames: Iterable[tuple[int, Transient]]) -> Iterator[tuple[int, Transient]]:
        """Each of these frames with its number and what others add to its light, at the mean moment of its exposure,
        once the next one is there. Tell `pictured` before the next is asked for."""
        waiting: deque[tuple[int, Response | None]] = deque()

        def moments() -> Iterator[Moments]:
            for number, calibrated in frames:
                waiting.append((number, calibrated.response))
                yield self.moments(number, calibrated)

        known = moments()
        first = next(known, None)
        if first is None:
            return
        self._memory = FollowingMemory(first.wall, first.time)
        for light in self._memory.each_brought(chain([first], known)):
            number, response = waiting.popleft()
            self._frames.append(float(self._memory.weights.sum()))
            yield number, replace(light, response=response)

    def moments(self, frame: int, calibrated: Transient) -> Moments:
        """The points of a frame, each with the moment when it was exposed."""
        time = replace(calibrated.time, bins=min(self._bins, calibrated.time.bins))
        calibrated = replace(calibrated, counts=calibrated.counts[: time.bins], time=time)
        records = self._records[self._plan.pass_[self._records["number"]] == frame]
        taken_s = np.zeros(calibrated.exposure_s.shape)
        place = (self._plan.positions.row[records["number"]], self._plan.positions.col[records["number"]])
        taken_s[place] = records["taken_s"] + records["live_time_s"] / 2
        return moments_of(calibrated, taken_s)

    def pictured(self, made: Reconstruction) -> None:
        """A picture was made of the last light given: what it shows is followed through the frames around it."""
        assert self._memory is not None
        self._memory.pictured(made)
