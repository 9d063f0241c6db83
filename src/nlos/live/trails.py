"""Where the objects of a film were in its last pictures, and how fast they are: lines on the page."""

from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.recon.local_lines import on_line, scatter
from nlos.recon.track import fitted
from nlos.recon.tracked_objects import FEWEST, Followed, ObjectTracker
from nlos.recon.volume import Reconstruction

KEPT = 40
"""Pictures that a trail goes back."""


class Trails:
    """Fed with pictures in the order of time; `told` may be asked for in another thread. Each place is by a straight
    line through those before it, where they agree (`local_lines`), and stays where it was shown."""

    def __init__(self) -> None:
        self._tracker: ObjectTracker | None = None
        self.told: list[dict[str, Any]] = []
        """Of each object seen now: its `object` number, `x_m` and `y_m` of its trail, `z_m`, velocities and their
        standard errors, NaN as None."""

    def add(self, picture: Reconstruction, time_s: float) -> None:
        """The next picture and its moment."""
        wall = picture.wall
        self._tracker = self._tracker or ObjectTracker(wall.x_m(), wall.y_m(), KEPT)
        self._tracker.add(picture.albedo, picture.depth_m, time_s)
        newest = max(self._tracker.time_s)
        self.told = [
            _told(each, self._tracker.time_s)
            for each in self._tracker.followed
            if len(each.places_m) >= FEWEST and max(each.places_m) == newest
        ]


def _told(one: Followed, time_s: dict[int, float]) -> dict[str, Any]:
    frames = sorted(one.places_m)
    places = np.stack([one.places_m[frame] for frame in frames])
    times = np.array([time_s[frame] for frame in frames])
    most = fitted(times)
    newest = slice(-most, None)
    velocity, error = _velocity(places[newest], times[newest])
    one.shown_m[frames[-1]], _ = on_line(places, times, len(frames) - 1, scatter(places, times), most)
    shown = np.stack([one.shown_m.get(frame, one.places_m[frame]) for frame in frames])
    return {
        "object": one.number, "x_m": shown[:, 0].round(4).tolist(), "y_m": shown[:, 1].round(4).tolist(),
        "z_m": round(float(shown[-1, 2]), 4), "velocity_m_per_s": _listed(velocity), "error_m_per_s": _listed(error),
    }  # fmt: skip


def _velocity(places: npt.NDArray[np.float64], time_s: npt.NDArray[np.float64]) -> tuple[Any, Any]:
    """Slopes (3,) of straight lines, and their standard errors."""
    times = time_s - time_s.mean()
    lever = float((times**2).sum())
    if not lever > 0:
        return np.full(3, np.nan), np.full(3, np.nan)
    slope = times @ places / lever
    left = places - places.mean(axis=0) - times[:, None] * slope
    free = len(places) - 2
    return slope, np.sqrt((left**2).sum(axis=0) / free / lever) if free else np.full(3, np.nan)


def _listed(values: npt.NDArray[np.float64]) -> list[float | None]:
    return [round(float(value), 4) if np.isfinite(value) else None for value in values]
