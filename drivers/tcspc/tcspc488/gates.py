"""The gates of a `tcspc488` in its stream of records, each held against the mirror's steps before it.

A count of steps at the end of many points does not show one that was missed and one that came twice: in between, every
point held its neighbour's photons. The stream has both kinds of marks with their times.
"""

import numpy as np
import numpy.typing as npt

from nlos.drivers.tcspc.t3 import Pulses
from nlos.drivers.tcspc.t3_points import StepMarkers, Windows

GATE_MARKER = 0b1000
_STEP_MARKERS = 0b0001, 0b0010


class Gates:
    """Finds the window of each gate; `compared`: the mirror's markers are wired, and it takes one step a gate."""

    def __init__(self, dwells: Pulses, compared: bool) -> None:
        self._windows, self._points = StepMarkers(dwells, 0, GATE_MARKER), len(dwells)
        self._compared, self._steps = compared, 0
        self.disagreement: tuple[int, int] | None = None
        """At the first gate out of step: the mirror's steps before it, and how many were due."""

    def __call__(self, pulses: Pulses, bits: npt.NDArray[np.uint8]) -> Windows:
        gates = pulses[(bits & GATE_MARKER) != 0]
        steps = np.sort(np.concatenate([pulses[(bits & line) != 0] for line in _STEP_MARKERS]))
        due = np.arange(self._windows.seen, self._windows.seen + len(gates)) + 1
        seen = self._steps + np.searchsorted(steps, gates, side="right")
        self._steps += len(steps)
        wrong = np.flatnonzero((seen != due) & (due <= self._points))
        if self._compared and self.disagreement is None and len(wrong):
            self.disagreement = int(seen[wrong[0]]), int(due[wrong[0]])
        return self._windows(pulses, bits)
