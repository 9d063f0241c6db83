"""Several objects in a film: where each is, how large and how fast, from when to when it is there."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy

from nlos.recon.track import SEEN, track

Floats = npt.NDArray[np.float64]

GAP = 0.08
"""Of the picture's longer side: parts that are no farther apart are one object."""
STEP = 0.1
"""Of the same: neighbouring pixels that differ by more in depth are of different objects."""
LEAST = 0.05
"""Of a frame's light: what holds less is a speck."""
FASTEST = 0.25
"""Of the same side, in one frame: what is farther from where it was expected is another object."""
MISSED = 2
"""Frames after which what is not seen any more has vanished."""
FEWEST = 3
"""Frames in which an object is seen; what is seen in fewer is taken for noise."""


@dataclass
class Followed:
    """One object: the part of each frame that is it."""

    number: int
    """In the order in which they appeared."""
    parts: dict[int, npt.NDArray[np.bool_]] = field(default_factory=dict)
    places_m: dict[int, Floats] = field(default_factory=dict)
    shown_m: dict[int, Floats] = field(default_factory=dict)
    """Where it was shown then, by whoever shows it."""

    def mask(self, shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
        """Which pixels of a film of that shape (F, H, W) are it."""
        nowhere = np.zeros(shape[1:], dtype=np.bool_)
        return np.stack([self.parts.get(frame, nowhere) for frame in range(shape[0])])

    def expected_m(self, frame: int, time_s: Mapping[int, float]) -> Floats:
        """Where it should be by its last two places, no farther ahead than it was seen to go."""
        *before, last = sorted(self.places_m)
        if not before:
            return self.places_m[last]
        share = (time_s[frame] - time_s[last]) / max(time_s[last] - time_s[before[-1]], 1e-9)
        way_m = min(share, 1.0) * (self.places_m[last] - self.places_m[before[-1]])
        return np.asarray(self.places_m[last] + way_m, dtype=np.float64)


class ObjectTracker:
    """Fed with the pictures of a film in the order of time, knows which part of each is which object.

    What of a frame belongs together is connected, but for small gaps, without steps in depth; from frame to frame it is
    what lies nearest to where it was expected (Kuhn's assignment, 1955). Two that touch are one as long as they do.
    """

    def __init__(self, x_m: Floats, y_m: Floats, kept: int | None = None) -> None:
        """Of `kept` frames, all unless given, places are remembered."""
        self._x_m, self._y_m, self._kept = x_m, y_m, kept
        self._side_m = float(max(np.ptp(x_m), np.ptp(y_m))) or 1.0  # of a single pixel there is no side
        self.time_s: dict[int, float] = {}
        self.followed: list[Followed] = []
        self._frame, self._appeared = -1, 0

    def add(self, light: npt.NDArray[np.floating], depth: npt.NDArray[np.floating], time_s: float) -> None:
        """The next picture (H, W), its depths NaN where nothing is seen, and its moment."""
        self._frame = frame = self._frame + 1
        self.time_s[frame] = time_s
        parts = _parts(light, depth, self._side_m)
        places_m = [_place_m(np.where(part, light, 0.0), depth, self._x_m, self._y_m) for part in parts]
        still = [each for each in self.followed if frame - max(each.places_m) <= MISSED]
        expected = [each.expected_m(frame, self.time_s) for each in still]
        off_m = np.array([[np.linalg.norm(a - b) for b in places_m] for a in expected]).reshape(len(still), len(parts))
        pairs = zip(*scipy.optimize.linear_sum_assignment(off_m), strict=True)
        known = {int(part): still[who] for who, part in pairs if off_m[who, part] < FASTEST * self._side_m}
        for number, (part, place_m) in enumerate(zip(parts, places_m, strict=True)):
            if number not in known:
                known[number] = Followed(self._appeared)
                self._appeared += 1
                self.followed.append(known[number])
            known[number].parts[frame], known[number].places_m[frame] = part, place_m
        if self._kept is not None:
            self._forget(frame - self._kept)

    def _forget(self, frame: int) -> None:
        """That frame, and objects that were not seen since."""
        self.time_s.pop(frame, None)
        for each in self.followed:
            each.parts.pop(frame, None)
            each.places_m.pop(frame, None)
            each.shown_m.pop(frame, None)
        self.followed = [each for each in self.followed if each.places_m]


def tracked_objects(
    albedo: npt.NDArray[np.floating],  # (F, H, W)
    depth_m: npt.NDArray[np.floating],  # (F, H, W), NaN where nothing is seen
    x_m: Floats,
    y_m: Floats,
    time_s: Floats,
    window: int = 1,
) -> list[dict[str, Floats]]:
    """For each object that an `ObjectTracker` finds `track` of its light alone, (F,) each, NaN in frames where it is
    not seen; in the order in which they appear."""
    tracker = ObjectTracker(x_m, y_m)
    for light, depth, at_s in zip(albedo, depth_m, time_s, strict=True):
        tracker.add(light, depth, float(at_s))
    fewest = min(FEWEST, len(albedo))
    found = [each for each in tracker.followed if len(each.parts) >= fewest]
    rows = []
    for each in found:
        own = each.mask(albedo.shape)
        rows.append(track(np.where(own, albedo, 0.0), np.where(own, depth_m, np.nan), x_m, y_m, time_s, window))
    return rows


def _parts(
    light: npt.NDArray[np.floating], depth: npt.NDArray[np.floating], side_m: float
) -> list[npt.NDArray[np.bool_]]:
    """What of one frame belongs together, (H, W) each, the brightest first."""
    seen = np.isfinite(depth) & (light > SEEN * light.max())
    if not seen.any():
        return []
    reach = max(1, round(GAP * max(light.shape) / 2))
    planes = np.floor(np.where(seen, depth, 0.0) / (STEP * side_m)).astype(int)
    first = int(planes[seen].min())
    solid = np.zeros((int(planes[seen].max()) - first + 1, *light.shape), dtype=np.bool_)
    row, col = np.nonzero(seen)
    solid[planes[row, col] - first, row, col] = True
    # Two planes that touch are within a step of one another.
    near = np.ones((3, 3), np.bool_)
    wide = np.stack([scipy.ndimage.binary_dilation(plane, near, iterations=reach) for plane in solid])
    labels, _ = scipy.ndimage.label(wide, np.ones((3, 3, 3), np.bool_))
    own = np.where(seen, labels[np.clip(planes - first, 0, len(solid) - 1), *np.indices(light.shape)], 0)
    sums = np.bincount(own.ravel(), np.where(seen, light, 0.0).ravel())
    sums[0] = 0.0
    return [own == number for number in np.argsort(-sums) if sums[number] > LEAST * sums.sum()]


def _place_m(light: npt.NDArray[np.floating], depth: npt.NDArray[np.floating], x_m: Floats, y_m: Floats) -> Floats:
    weight = light / light.sum()
    across, down = np.meshgrid(x_m, y_m)
    return np.array([float((weight * each).sum()) for each in (across, down, np.nan_to_num(depth))])
