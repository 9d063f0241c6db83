"""Continuous lines: for dwells shorter than the settling time, the mirror is kept moving and never settles.

A mirror that follows a ramp trails it by a constant lag. Commands lead by that lag, so that the beam crosses each point
in the middle of its dwell; every line begins with a run-up, during which the mirror reaches the ramp's speed and the
counter's points are thrown away. What this costs is sharpness: a point is smeared over a pixel along the line.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.sample import ScanPoint
from nlos.acquisition.scanning.clocked import WAITING_NUMBER, Settle, Stepping
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles

EVEN = 0.1
"""How much one step of a line may differ from the one before, as a fraction."""
LONGEST = 4096
"""Points of the longest line that is looked for."""
REST = 0.1
"""Pixels that the trailing may still be off when the run-up is over."""

Floats = npt.NDArray[np.float64]


class Lines:
    """The lines of a plan: which points lie evenly on one straight line, with the same dwell."""

    def __init__(self, plan: ScanPlan, angles: Sequence[MirrorAngles], lag_s: float) -> None:
        self.place = np.array([(each.x_rad, each.y_rad) for each in angles])  # (N, 2)
        self.dwell_s = plan.dwell_s
        self.lag_s = lag_s
        self.first, self.end = np.empty(len(plan), dtype=np.intp), np.empty(len(plan), dtype=np.intp)
        first = 0
        while first < len(plan):
            end = first + line_length(self.place[first : first + LONGEST], plan.dwell_s[first : first + LONGEST])
            self.first[first:end], self.end[first:end] = first, end
            first = end

    def commands(self, first: int, end: int, settle: Settle) -> list[MirrorAngles]:
        """What the mirror is told for the points `first` up to `end`, run-up included. Raises `LimitError` for a line
        that it could not even jump across in its time."""
        ends = MirrorAngles(*self.place[first]), MirrorAngles(*self.place[end - 1])
        jump_s, line_s = settle(*ends), float(self.dwell_s[first:end].sum())
        if jump_s > line_s:
            raise LimitError(
                "mirror",
                f"cannot follow a line in {line_s * 1e3:.3g} ms that takes it {jump_s * 1e3:.3g} ms in one jump.",
                "Raise dwell_ms, scan a smaller wall, or take `continuous` out of the scan file.",
            )
        return _line(self.place[first:end], self.lag_s / float(self.dwell_s[first]))


def sweep(
    points: Sequence[ScanPoint],
    angles: Sequence[MirrorAngles],
    settle: Settle,
    most: int,
    list_mode: bool,
    lines: Lines,
) -> Stepping:
    """As many lines of `points` as fit `most` entries, without blanking. A line of which points are already taken is
    swept whole, so that the beam's way does not depend on what was measured. In list mode, whose clock has one period,
    waiting takes several entries, and another dwell ends the sequence. Raises `LimitError` for a line that does not fit
    or is too fast."""
    made = Stepping([], [], [], [], 0.0, 0)
    at = 0
    while at < len(points):
        number = points[at].number
        first, end = int(lines.first[number]), int(lines.end[number])
        wanted = {}
        while at < len(points) and first <= points[at].number < end and points[at].number not in wanted:
            wanted[points[at].number] = at
            at += 1
        dwell_s = float(lines.dwell_s[first])
        commands = lines.commands(first, end, settle)
        wait_s = settle(made.angles[-1], commands[0]) if made.angles else 0.0
        waits = math.ceil(wait_s / dwell_s - 1e-9) if list_mode else int(wait_s > 0)
        entries = waits + len(commands)
        if len(made.index) + entries > most or (list_mode and made.count and dwell_s != made.dwells_s[0]):
            if made.count:
                break
            raise LimitError(
                "mirror",
                f"holds {most} positions; a continuous line of {end - first} points takes {entries} with its run-up.",
                "Plan shorter lines, or take `continuous` out of the scan file.",
            )
        run_up = len(commands) - (end - first)
        index = [-1] * (waits + run_up) + [wanted.get(each, -1) for each in range(first, end)]
        made.numbers.extend(
            points[k].number if k >= 0 else WAITING_NUMBER - entry for entry, k in enumerate(index, len(made.index))
        )
        made.angles.extend([commands[0]] * waits + commands)
        made.dwells_s.extend([dwell_s if list_mode else _whole_us(wait_s)] * waits + [dwell_s] * len(commands))
        made.index.extend(index)
        made = replace(made, count=at)
    return made


def line_length(place: Floats, dwells_s: Floats) -> int:
    """How many points from the first on lie evenly on one straight line and have the same dwell."""
    if len(place) < 2 or dwells_s[1] != dwells_s[0]:
        return 1
    steps = np.diff(place, axis=0)
    change = np.hypot(*np.diff(steps, axis=0).T)
    uneven = change > EVEN * np.hypot(*steps[:-1].T)
    breaks = np.flatnonzero(uneven | (dwells_s[2:] != dwells_s[0]))
    return int(breaks[0]) + 2 if len(breaks) else len(place)


def _line(place: Floats, lag: float) -> list[MirrorAngles]:
    """Commands for a line that the beam trails by `lag` points: run-up, then one for each point."""
    if len(place) == 1:
        return [MirrorAngles(*place[0])]
    run_up = math.ceil(lag * math.log(lag / REST + math.e)) if lag > 0 else 0
    at = np.arange(-run_up, len(place)) + lag
    inner = np.stack([np.interp(at, np.arange(len(place)), column) for column in place.T], axis=1)
    before = np.minimum(at, 0.0)[:, None] * (place[1] - place[0])
    after = np.maximum(at - (len(place) - 1), 0.0)[:, None] * (place[-1] - place[-2])
    return [MirrorAngles(x, y) for x, y in (inner + before + after).tolist()]


def _whole_us(seconds: float) -> float:
    return max(math.ceil(round(seconds * 1e6, 3)), 1) * 1e-6
