"""How long the beam dwells on each point, and how often it comes back."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from acquisition.positions import Positions
from configs.settings import Settings

DWELL_STEP_S = 1e-6
"""Dwells are whole microseconds: what counters can be set to exactly."""


@dataclass(frozen=True, eq=False)
class Visits:
    """Which position is visited when, for how long, in which pass."""

    index: npt.NDArray[np.intp]  # (M,) into the positions
    dwell_s: npt.NDArray[np.float64]  # (M,)
    pass_: npt.NDArray[np.int32]  # (M,)


def whole_microseconds(dwell_s: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """`dwell_s` on the counters' grid of microseconds, at least one."""
    return np.maximum(np.round(np.asarray(dwell_s, dtype=np.float64) / DWELL_STEP_S), 1.0) * DWELL_STEP_S


class Uniform(Settings):
    """The same dwell everywhere."""

    kind: Literal["uniform"] = "uniform"

    def visits(self, positions: Positions, dwell_s: float) -> Visits:
        """One visit of `dwell_s` to every position."""
        count = len(positions)
        return Visits(
            index=np.arange(count),
            dwell_s=whole_microseconds(np.full(count, dwell_s)),
            pass_=np.zeros(count, dtype=np.int32),
        )


Exposure = Annotated[Uniform, Field()]
