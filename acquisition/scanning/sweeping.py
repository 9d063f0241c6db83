"""Continuous lines: for dwells shorter than the settling time, the mirror is kept moving and never settles.

A mirror that follows a ramp trails it by a constant lag. Commands lead by that lag, so that the beam crosses each point
in the middle of its dwell; every line begins at rest with a run-up, during which the mirror reaches the ramp's speed
and the counter's points are thrown away. What this costs is sharpness: a point is smeared over a pixel along the line.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.aim import Aiming
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.sample import ScanPoint
from nlos.acquisition.scanning.clocked import Settle, Stepping
from nlos.acquisition.scanning.lag import Lag
from nlos.drivers.bench import Bench
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.tcspc.counter import WAITING_NUMBER

EVEN = 0.1
"""How much one step of a line may differ from the one before, as a fraction."""
LONGEST = 4096
"""Points of the longest line that is looked for."""
RUN_UP = 2.0
"""How long a run-up is, in settling times of one step and the lag: a servo that settles to a tenth in one has less than
one hundredth left."""
SETTLED = "Raise dwell_ms, scan a smaller wall, or take `continuous` out of the scan file."

Floats = npt.NDArray[np.float64]


class LineRefused(LimitError):
    """A line that this bench cannot sweep: its points can still be taken one by one. `lag`: what a measurement had
    found of it by then."""

    lag: Lag | None = None


class Lines:
    """The lines of a plan: which points lie evenly on one straight line, with the same dwell. Their run-ups, which
    are lit, too, stay within what the bench allows and reaches. `aim`: what made the angles; `lag_s` may be set."""

    def __init__(self, plan: ScanPlan, bench: Bench, angles: Sequence[MirrorAngles], aim: Aiming) -> None:
        self.place = np.array([(each.x_rad, each.y_rad) for each in angles])  # (N, 2)
        self._on_wall_m = np.stack([plan.positions.x_m, plan.positions.y_m], axis=1)  # (N, 2)
        self._allowed, self._reach, self._aim = bench.settings.geometry.allowed, bench.mirror.check, aim
        self.dwell_s = plan.dwell_s
        self.lag_s = 0.0
        self.first, self.end = np.empty(len(plan), dtype=np.intp), np.empty(len(plan), dtype=np.intp)
        first = 0
        while first < len(plan):
            end = first + line_length(self.place[first : first + LONGEST], plan.dwell_s[first : first + LONGEST])
            self.first[first:end], self.end[first:end] = first, end
            first = end

    def check(self, settle: Settle, most: int) -> None:
        """Raises `LineRefused` where one of them cannot be swept by the lag that is set, `most` entries a sequence."""
        firsts = np.unique(self.first)
        ends = self.end[firsts]
        looks = np.column_stack([self.place[firsts], self.place[ends - 1], ends - firsts, self.dwell_s[firsts]])
        _, once = np.unique(looks, axis=0, return_index=True)  # frames have the same lines
        for first, end in zip(firsts[once].tolist(), ends[once].tolist(), strict=True):
            if (entries := len(self.commands(first, end, settle))) > most:
                raise too_long(most, end - first, entries)

    def commands(self, first: int, end: int, settle: Settle) -> list[MirrorAngles]:
        """What the mirror is told for the points `first` up to `end`, run-up included. Raises `LineRefused` for a line
        that it could not even jump across in its time, or whose run-up leaves what is allowed or reached."""
        return self.along(np.arange(first, end), settle)

    def along(self, numbers: npt.NDArray[np.intp], settle: Settle, dwell_s: float | None = None) -> list[MirrorAngles]:
        """The same for points of one line in either direction, and at another pace than the plan's."""
        place = self.place[numbers]
        dwell_s = dwell_s or float(self.dwell_s[numbers[0]])
        jump_s, line_s = settle(MirrorAngles(*place[0]), MirrorAngles(*place[-1])), dwell_s * len(place)
        if jump_s > line_s:
            raise LineRefused(
                "mirror",
                f"cannot follow a line in {line_s * 1e3:.3g} ms that takes it {jump_s * 1e3:.3g} ms in one jump.",
                SETTLED,
            )
        if len(place) == 1:
            return [MirrorAngles(*place[0])]
        step_s = settle(MirrorAngles(*place[0]), MirrorAngles(*place[1]))
        run_up = math.ceil(RUN_UP * (step_s + max(self.lag_s, 0.0)) / dwell_s - 1e-9)
        way = _line(place, self.lag_s / dwell_s, run_up)
        commands = [MirrorAngles(x, y) for x, y in way.tolist()]
        self._check(int(numbers[0]), commands[0])
        self._check(int(numbers[-1]), commands[-1])
        return commands

    def _check(self, point: int, end: MirrorAngles) -> None:
        """Of an end of a line beyond a point of it: equal steps of the mirror are ever longer ones on the wall."""
        try:
            self._reach(end)
            if self._allowed is not None:
                x_m, y_m = (
                    self._on_wall_m[point] + self._on_wall(end.x_rad, end.y_rad) - self._on_wall(*self.place[point])
                )
                self._allowed.check(float(x_m), float(y_m))
        except LimitError as error:
            what = f"the run-up of a continuous line, which is lit: {error.what}"
            raise LineRefused(
                error.device, what, f"{error.remedy} Or take `continuous` out of the scan file."
            ) from error

    def _on_wall(self, x_rad: float, y_rad: float) -> Floats:
        """x and y (2,), in metres."""
        return np.concatenate(self._aim.wall_points(np.array([x_rad]), np.array([y_rad])))


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
    waiting takes several entries, and another dwell ends the sequence. Raises `LineRefused` for a line that does not
    fit or is too fast."""
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
        index = [wanted.get(each, -1) for each in range(first, end)]
        longer = append_line(made, lines.commands(first, end, settle), index, dwell_s, settle, list_mode)
        if len(longer.index) > most or (list_mode and made.count and dwell_s != made.dwells_s[0]):
            if made.count:
                break
            raise too_long(most, end - first, len(longer.index))
        numbers = [points[k].number if k >= 0 else WAITING_NUMBER - entry for entry, k in enumerate(longer.index)]
        made = replace(longer, numbers=numbers, count=at)
    return made


def append_line(
    made: Stepping, commands: list[MirrorAngles], index: list[int], dwell_s: float, settle: Settle, list_mode: bool
) -> Stepping:
    """A sequence with one more line: the mirror comes to rest at the beginning of its run-up. `index`: as `Stepping`'s,
    for the points of the line. The numbers are left to the caller."""
    wait_s = 0.0
    if made.angles:
        # The end of the line before was no rest: what a step takes to settle comes on top of the jump.
        wait_s = settle(made.angles[-1], commands[0]) + settle(commands[0], commands[-1 if len(commands) < 2 else 1])
    waits = math.ceil(wait_s / dwell_s - 1e-9) if list_mode else int(wait_s > 0)
    thrown = waits + len(commands) - len(index)
    waited_s = dwell_s if list_mode else _whole_us(wait_s)
    return replace(
        made,
        angles=[*made.angles, *[commands[0]] * waits, *commands],
        dwells_s=[*made.dwells_s, *[waited_s] * waits, *[dwell_s] * len(commands)],
        index=[*made.index, *[-1] * thrown, *index],
    )


def too_long(most: int, points: int, entries: int) -> LineRefused:
    """What to say of a line that no sequence holds."""
    return LineRefused(
        "mirror",
        f"holds {most} positions; a continuous line of {points} points takes {entries} with its run-up.",
        "Plan shorter lines, or take `continuous` out of the scan file.",
    )


def line_length(place: Floats, dwells_s: Floats) -> int:
    """How many points from the first on lie evenly on one straight line and have the same dwell."""
    if len(place) < 2 or dwells_s[1] != dwells_s[0]:
        return 1
    steps = np.diff(place, axis=0)
    change = np.hypot(*np.diff(steps, axis=0).T)
    uneven = change > EVEN * np.hypot(*steps[:-1].T)
    breaks = np.flatnonzero(uneven | (dwells_s[2:] != dwells_s[0]))
    return int(breaks[0]) + 2 if len(breaks) else len(place)


def _line(place: Floats, lag: float, run_up: int) -> Floats:
    """Places to command, (run_up + N, 2), for a line (N, 2) that the beam trails by `lag` points: `run_up` of them,
    then one for each point."""
    at = np.arange(-run_up, len(place)) + lag
    inner = np.stack([np.interp(at, np.arange(len(place)), column) for column in place.T], axis=1)
    before = np.minimum(at, 0.0)[:, None] * (place[1] - place[0])
    after = np.maximum(at - (len(place) - 1), 0.0)[:, None] * (place[-1] - place[-2])
    return np.asarray(inner + before + after)


def _whole_us(seconds: float) -> float:
    return max(math.ceil(round(seconds * 1e6, 3)), 1) * 1e-6
