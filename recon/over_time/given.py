"""What a network for films is given of each frame beside its picture: the newest frame's own light, how much light the
memory holds, and how what is seen has moved."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.recon.over_time.path import along

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.float32]

AROUND = (-3, 0, 3)
"""Planes of the volume from a picture's surface, at which the newest frame's light is looked up."""
OWN = 3 + len(AROUND)
TOLD = 4


@dataclass(frozen=True, eq=False)
class Given:
    """Of one frame of a film and the memory of those before it."""

    look: Callable[[], tuple[Picture, Floats]]
    """The volume (D, h, w) of the newest frame's light alone, by the light-cone transform, in any unit, and the depths
    of its planes (D,)."""
    repeats: float
    """How well a second frame would agree with it, see `registration.Seen`."""
    light: float
    """How many frames' light the memory holds."""
    photons: tuple[float, float]
    """Of the newest frame, and of all that is held, by its weights."""
    points: int
    """Of the newest frame."""
    moments_s: Floats  # (F,) of the frames held, the newest one last
    path_m: Floats  # (F, 3), where what is seen was at these moments, from where it is now

    @property
    def moment_s(self) -> float:
        """The mean moment of the newest frame's exposure."""
        return float(self.moments_s[-1])

    def way_m(self, since_s: float) -> Floats:
        """(3,): how far what is seen has moved since then."""
        return np.asarray(-along(self.path_m, self.moments_s, np.array([since_s]))[0], dtype=np.float64)

    def told(self) -> Picture:
        """(TOLD,) of order 1: light held and photons as logarithms, and how well frames repeat."""
        newest, held = (np.log10(max(each, 1.0)) - 3.5 for each in self.photons)
        return np.array([np.log2(max(self.light, 0.5)) / 2, newest, held, self.repeats], dtype=np.float32)

    def own(self, depth_m: Picture, width_m: float, seen: Picture | None) -> Picture:
        """(OWN, h, w): the newest frame's light at its highest over depth, how many wall widths that lies behind
        `depth_m` (h, w), and the light around that depth; over the highest of all. And how much of what the picture's
        volume `seen` (D, h, w) holds is at its highest."""
        made, depths_m = self.look()
        volume = np.maximum(made, 0.0) / max(float(made.max(initial=0.0)), 1e-30)
        highest = volume.max(axis=0)
        behind = (depths_m[volume.argmax(axis=0)] - depth_m) / width_m
        at = np.searchsorted(depths_m, depth_m)
        row, col = np.indices(depth_m.shape)
        there = [volume[np.clip(at + step, 0, len(volume) - 1), row, col] for step in AROUND]
        sure = np.zeros(depth_m.shape) if seen is None else seen.max(axis=0) / np.maximum(seen.sum(axis=0), 1e-6)
        return np.stack([highest, np.clip(4 * behind, -2, 2), *there, sure]).astype(np.float32)


def depth_everywhere(albedo: Picture, depth_m: Picture) -> Picture:
    """(H, W): where nothing is seen, the mean depth of what is."""
    seen = np.isfinite(depth_m)
    weight = np.where(seen, albedo, 0.0).astype(np.float64) ** 2
    mean_m = float((weight * np.where(seen, depth_m, 0.0)).sum() / weight.sum()) if weight.any() else 1.0
    return np.where(seen, depth_m, np.float32(mean_m)).astype(np.float32)
