"""A plan that lists more than it has time for: what each of its candidates costs, and how many fit the time."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Budget:
    """Bench time for a plan whose points are candidates. `step_us`: what a point costs beside its dwell, the move to it
    and its readout. `batch`: how many points are chosen together, before anybody may say again which come next.
    `after_first`: the first pass is taken whole, in the plan's order, before anybody is asked."""

    total_us: int
    step_us: int
    batch: int
    after_first: bool = False

    def __post_init__(self) -> None:
        if not (self.total_us > 0 and self.step_us >= 0 and self.batch >= 1):
            raise ValueError(f"a budget of {self.total_us} us, {self.step_us} us a step, batches of {self.batch}")

    def costs_us(self, dwell_s: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        """Of points with these dwells, in the same shape."""
        return np.round(dwell_s * 1e6).astype(np.int64) + self.step_us

    def first(self, costs_us: npt.NDArray[np.int64], left_us: int) -> int:
        """How many of the points with these costs, in order, fit into the time that is left."""
        return int(np.searchsorted(np.cumsum(costs_us), left_us, side="right"))

    def most(self, costs_us: npt.NDArray[np.int64]) -> int:
        """How many points a scan can take at all: the cheapest ones."""
        return self.first(np.sort(costs_us), self.total_us)
