"""A pattern scanned again and again: which points each frame takes, and in which direction."""

from typing import Literal

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.exposure import Visits
from nlos.acquisition.planning.positions import Positions

Parts = Literal[1, 2, 4, 8, 16, 32, 64]
"""Into how many parts points can be interleaved."""
MOST_FRAMES = 100_000
MOST_VISITS = 1 << 21
"""Of a film until it is stopped: each is listed in its plan, before the first one."""


def in_frames(positions: Positions, visits: Visits, frames: int, parts: Parts) -> Visits:
    """`visits` of one pass as `frames` passes: frame k takes part k mod `parts` of the points.

    Every other frame runs backwards: it begins where the one before ended, so that no frame pays for a way back and
    a sequence may hold several. Raises `PlanRefused` where there are fewer points than parts, or fewer frames.
    """
    if parts > frames:
        raise PlanRefused(
            f"{frames} frames visit only {frames} of interleave: {parts} parts; raise frames or lower interleave"
        )
    if len(visits.index) < parts:
        raise PlanRefused(f"{len(visits.index)} points cannot be divided into {parts} parts; lower interleave")
    part = part_of(positions.take(visits.index), parts)
    members = [np.flatnonzero(part == each) for each in range(parts)]
    order = [members[frame % parts][:: -1 if frame % 2 else 1] for frame in range(frames)]
    chosen = np.concatenate(order)
    number = np.repeat(np.arange(frames, dtype=np.int32), [len(each) for each in order])
    return Visits(visits.index[chosen], visits.dwell_s[chosen], number)


def most_frames(points: int, parts: Parts, bins: int, largest_bytes: int) -> int:
    """How many frames of so many points in all parts a recording of a film that somebody ends may hold: whole rounds
    of the parts, one at least."""
    rounds = min(MOST_VISITS, largest_bytes // (4 * bins)) // points
    return max(min(rounds, MOST_FRAMES // parts), 1) * parts


def part_of(positions: Positions, parts: Parts) -> npt.NDArray[np.intp]:
    """The part that each point belongs to, (N,). On a grid every part is a coarser grid (a checkerboard for two), and
    successive ones lie far apart, as Bayer's matrix orders them (1973); elsewhere it is every so-many-th point."""
    along = np.arange(len(positions)) % parts
    if parts == 1 or not positions.on_grid:
        return along
    side = 2
    while side * side < parts:
        side *= 2
    # Ranks, not rows: a pattern may leave rows and columns of the grid out.
    row, col = (np.unique(each, return_inverse=True)[1].reshape(-1) for each in (positions.row, positions.col))
    part = bayer(side)[row % side, col % side] * parts // (side * side)
    return part if len(np.unique(part)) == parts else along


def bayer(side: int) -> npt.NDArray[np.intp]:
    """Bayer's matrix of a power of two, (side, side): 0 to side^2 - 1, neighbours far apart in number."""
    made = np.zeros((1, 1), dtype=np.intp)
    while len(made) < side:
        made = np.block([[4 * made, 4 * made + 2], [4 * made + 3, 4 * made + 1]])
    return made
