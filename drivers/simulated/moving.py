"""The surfels of a scene at every moment: those that rest, and those that move."""

from collections.abc import Sequence

import numpy as np

from nlos.drivers.simulated.motion import Pose, pose_at
from nlos.drivers.simulated.surfaces import Surface, Surfels, surfels

MOST_MOMENTS = 32
"""At how many moments of one dwell a scene is looked at, at most."""


class Scenery:
    """Surfaces cut into surfels of about `spacing_m`, moved along their paths."""

    def __init__(self, surfaces: Sequence[Surface], spacing_m: float) -> None:
        self._spacing_m = spacing_m
        self._still = surfels([each for each in surfaces if not each.moves], spacing_m)
        self._moving = [each for each in surfaces if each.moves]
        at_rest = {"centre_m": (0.0, 0.0, 0.0), "pitch_deg": 0.0, "yaw_deg": 0.0, "roll_deg": 0.0}
        self._own = [surfels([each.model_copy(update=at_rest)], spacing_m) for each in self._moving]

    @property
    def moves(self) -> bool:
        """Whether it is not always the same."""
        return bool(self._moving)

    def at(self, time_s: float) -> Surfels:
        """All surfels that are there so many seconds after the first point was lit."""
        parts = [self._still]
        for surface, own in zip(self._moving, self._own, strict=True):
            if surface.is_there(time_s):
                pose = pose_at(time_s, surface.pose, surface.path)
                positions = own.positions_m @ pose.rotation.T + np.array(pose.centre_m)
                normals = own.normals @ pose.rotation.T
                parts.append(Surfels(positions, normals, own.reflectance_m2, own.retroreflective))
        return Surfels(
            np.concatenate([part.positions_m for part in parts]),
            np.concatenate([part.normals for part in parts]),
            np.concatenate([part.reflectance_m2 for part in parts]),
            np.concatenate([part.retroreflective for part in parts]),
        )

    def moments(self, start_s: float, dwell_s: float) -> int:
        """At how many moments of a dwell to look, so that nothing moves by more than a surfel in between."""
        farthest = 1.0
        for surface, own in zip(self._moving, self._own, strict=True):
            one, other = (pose_at(each, surface.pose, surface.path) for each in (start_s, start_s + dwell_s))
            comes_or_goes = surface.is_there(start_s) != surface.is_there(start_s + dwell_s)
            way_m = _way_m(one, other, float(np.abs(own.positions_m).max()))
            farthest = max(farthest, MOST_MOMENTS if comes_or_goes else way_m / self._spacing_m)
        return min(int(np.ceil(farthest)), MOST_MOMENTS)


def _way_m(one: Pose, other: Pose, reach_m: float) -> float:
    """How far a point of an object that reaches so far from its centre gets, at most."""
    shift_m = float(np.linalg.norm(np.subtract(one.centre_m, other.centre_m)))
    return shift_m + float(np.linalg.norm(one.rotation - other.rotation)) * reach_m
