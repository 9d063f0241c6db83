"""The light that pictures of a film are made of with a memory: a frame's own, and that of earlier ones moved along."""

from dataclasses import replace

import numpy as np

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.transient import Transient
from nlos.recon.over_time.following import FollowingMemory
from nlos.recon.over_time.moments import moments_of
from nlos.recon.volume import Reconstruction


class FilmMemory:
    """Fed with the calibrated frames of one recording, in the order of time, and told all of them as one scan: what its
    points have behind their direct light is looked at. Raises `InvalidData` for free positions, whose light has no
    place on the grid until it is moved."""

    def __init__(self, recording: Recording, whole: Transient) -> None:
        if not recording.on_grid:
            raise InvalidData(f"{recording.path}: its points are off the grid; --memory moves light along a grid")
        self._plan, self._records = recording.plan, recording.intact_records()
        self._memory: FollowingMemory | None = None
        self._frames: list[float] = []
        self._bins = whole.time.bins

    @property
    def frames_to_a_picture(self) -> int:
        """How many frames' light a picture holds, on average: neighbouring ones share it."""
        return round(float(np.mean(self._frames or [1.0])))

    def with_earlier(self, frame: int, calibrated: Transient) -> Transient:
        """The light of `frame` and what earlier ones add to it, at the mean moment of its exposure."""
        time = replace(calibrated.time, bins=min(self._bins, calibrated.time.bins))
        calibrated = replace(calibrated, counts=calibrated.counts[: time.bins], time=time)
        records = self._records[self._plan.pass_[self._records["number"]] == frame]
        taken_s = np.zeros(calibrated.exposure_s.shape)
        place = (self._plan.positions.row[records["number"]], self._plan.positions.col[records["number"]])
        taken_s[place] = records["taken_s"] + records["live_time_s"] / 2
        self._memory = self._memory or FollowingMemory(calibrated.wall, calibrated.time)
        light = self._memory.add(moments_of(calibrated, taken_s))
        self._frames.append(float(self._memory.weights.sum()))
        return replace(light, response=calibrated.response)

    def pictured(self, made: Reconstruction) -> None:
        """A picture was made of that light: what it shows is followed through the next frames."""
        assert self._memory is not None
        self._memory.pictured(made)
