"""Adaptive: every pixel is a candidate, and what is taken next is decided while the scan runs, in a limit of time."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.budget import Budget
from nlos.acquisition.planning.exposure import Visits, whole_microseconds
from nlos.acquisition.planning.patterns.coarse_to_fine import CoarseToFine
from nlos.acquisition.planning.positions import Positions
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings

LEAST, PARTS = 32, 8
"""A batch where none is said: the path through fewer points costs more than their choice gains."""
MOST_BATCHES = 500
"""Each leaves a line in the event log, which holds 1,024."""


class Adaptive(Settings):
    """Batches of pixels where and as long as they help the picture most, in `seconds` of bench time.

    Whoever makes pictures says which points come next; without advice in time the scan goes on coarse to fine. A pixel
    may be visited once in each of `lengths`: with `dwell_ms`, with twice that, four times, and so on.
    """

    kind: Literal["adaptive"] = "adaptive"
    seconds: float = Field(gt=0, le=1e6)
    """Bench time of all points together: dwell, and `step_ms` for each."""
    step_ms: float = Field(default=0.5, ge=0, le=1000)
    """What the move to a point and its readout count for, beside its dwell."""
    lengths: int = Field(default=3, ge=1, le=6)
    """Dwells to choose from: `dwell_ms` and doubles of it."""
    batch: int | None = Field(default=None, ge=1, le=4096)
    """Points that are chosen, and put on a short path, together. Default: an eighth of what fits the time, at least
    32."""

    def points(self, wall: WallGrid) -> Positions:
        """Every pixel once, coarse to fine."""
        return CoarseToFine().points(wall)

    def visits(self, positions: Positions, dwell_s: float) -> Visits:
        """Every position in every length, the shortest first; a length is a pass."""
        count, dwells_s = len(positions), [dwell_s * 2**length for length in range(self.lengths)]
        return Visits(
            index=np.tile(np.arange(count), self.lengths),
            dwell_s=whole_microseconds(np.repeat(dwells_s, count)),
            pass_=np.repeat(np.arange(self.lengths, dtype=np.int32), count),
        )

    def budget(self, visits: Visits) -> Budget:
        """Raises `PlanRefused` for a time that holds no point, or all of them, and for more batches than are kept."""
        made = Budget(round(self.seconds * 1e6), round(self.step_ms * 1e3), self.batch or LEAST)
        costs_us = made.costs_us(visits.dwell_s)
        most = made.most(costs_us)
        if not most:
            raise PlanRefused(f"{self.seconds:g} s do not hold a single point of {visits.dwell_s.min() * 1e3:g} ms")
        if most == len(costs_us):
            raise PlanRefused(
                f"all {most} visits take {costs_us.sum() / 1e6:g} s, and {self.seconds:g} s leave nothing to choose: "
                "lower seconds, raise lengths, or take pattern coarse_to_fine"
            )
        if self.batch is None:
            return replace(made, batch=max(LEAST, -(-most // PARTS)))
        if most > MOST_BATCHES * made.batch:
            raise PlanRefused(
                f"{most} points in batches of {made.batch} are more than the {MOST_BATCHES} batches whose reasons a "
                f"recording keeps; raise batch to {-(-most // MOST_BATCHES)}"
            )
        return made
