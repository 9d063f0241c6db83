"""Whether a scan's light would be explained better by a wall of another size than it says.

Light that is taken for that of a wrong wall still makes a picture, and the picture still explains much of it: less than
the right one would. How much less depends on the scene, so the same photons are judged again, by the same method, with
a wall a quarter wider or narrower: where the light-cone transform, which costs little, is sharper with it, or where so
little is explained that it cannot tell. A wrong time zero moves all light along the cones, whose curvature is then that
of another depth: to first order, t / 2 too much of the light's way is t / 4 too much of the wall.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import Transient
from nlos.recon.sharpness import sharpness

TELLING = ("nano",)
"""Methods whose pictures fit light so closely that a wrong wall shows in how much they explain."""
ENOUGH = 0.93
"""A picture that explains so much leaves nothing for another wall to gain."""
POOR = 0.7
"""Below it the light of a wall that is said to be too narrow need not come together more sharply on a wider one."""
WIDER = 1.25
GAIN, ERRORS = 0.03, 3.0
"""The light that another wall must explain more, as a share and in standard errors."""
CLEAR = 0.10
"""From such a gain on the wall is doubted; below it the light must also come together more sharply on the other."""
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Judged:
    """How much of the light a picture explains; and, for each point of the wall, what it misses and what there is."""

    share: float | None
    error: float
    note: str
    missed: Floats  # (N,)
    there: Floats  # (N,)

    def gain(self, other: "Judged") -> tuple[float, float]:
        """The share that `other` explains more, of the same light at the same points, and its standard error."""
        total, more = float(self.there.sum()), self.missed - other.missed
        gain = float(more.sum()) / total
        return gain, float(np.sqrt(len(more) * (more - gain * self.there).var())) / total


def better_wall(scan: Transient, told: Judged, judge: Callable[[float], Judged | None]) -> str:
    """What speaks for another wall than that of `scan`, in words; empty where nothing does.

    `told` is how its own wall was judged; `judge` does so with one that is so many times as large, None where there is
    no picture: once for most scans that it is asked about at all. Without a share nothing is known to speak for one.
    """
    share = told.share
    if share is None or share >= ENOUGH:
        return ""
    judged = cache(judge)
    own = sharpness(scan, 1.0)
    for scale in (WIDER, 1 / WIDER):
        sharper = sharpness(scan, scale) > own
        if not sharper and not (scale > 1 and share < POOR):
            continue
        other = judged(scale)
        if other is None:
            continue
        gain, error = told.gain(other)
        if gain < max(GAIN, ERRORS * error) or not (sharper or gain > CLEAR):
            continue
        opposite = judged(1 / scale)
        if opposite is not None and told.gain(opposite)[0] > 0:
            continue
        return (
            f"a wall {scale:.3g} times as large explains {100 * (share + gain):.0f} % of the light instead of "
            f"{100 * share:.0f} %: check the wall's size, time zero and falloff"
        )
    return ""
