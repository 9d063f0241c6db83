"""Continuous lines: for dwells shorter than the settling time, the mirror is kept moving and never settles.

A mirror that follows a ramp trails it by a constant lag. Commands lead by that lag, so that the beam crosses each point
in the middle of its dwell; every line begins with a run-up, during which the mirror reaches the ramp's speed and the
counter's points are thrown away. What this costs is sharpness: a point is smeared over a pixel along the line.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from acquisition.clocked import WAITING_NUMBER, Settle, Stepping
from acquisition.sample import ScanPoint
from drivers.errors import LimitError
from drivers.galvo.mirror import MirrorAngles

EVEN = 0.1
"""How much one step of a line may differ from the one before, as a fraction."""
REST = 0.1
"""Pixels that the trailing may still be off when the run-up is over."""

Angles = npt.NDArray[np.float64]


def sweep(
    points: Sequence[ScanPoint],
    angles: Sequence[MirrorAngles],
    settle: Settle,
    most: int,
    list_mode: bool,
    lag_s: float,
) -> Stepping:
    """As many whole lines of `points` as fit `most` entries, without blanking. In list mode, whose clock has one
    period, waiting takes several entries, and another dwell ends the sequence. Raises `LimitError` for a line that
    does not fit, or that the mirror could not even jump across in its time."""
    place = np.array([(each.x_rad, each.y_rad) for each in angles[:most]])
    made = Stepping([], [], [], [], 0.0, 0)
    first = 0
    while first < len(place):
        end = first + line_length(place[first:], [point.dwell_s for point in points[first : len(place)]])
        whole = end < len(place) or len(place) == len(points)
        dwell_s = points[first].dwell_s
        _check_pace(settle(angles[first], angles[end - 1]), (end - first) * dwell_s)
        line = _line(place[first:end], lag_s / dwell_s)
        wait_s = settle(made.angles[-1], line[0]) if made.angles else 0.0
        waits = math.ceil(wait_s / dwell_s - 1e-9) if list_mode else int(wait_s > 0)
        entries = waits + len(line)
        if len(made.index) + entries > most or not whole or (list_mode and first and dwell_s != points[0].dwell_s):
            if first == 0:
                raise LimitError(
                    "mirror",
                    f"a continuous line of {end} points with its run-up takes {entries} positions; it holds {most}.",
                    "Plan shorter lines, or take `continuous` out of the scan file.",
                )
            break
        made.angles.extend([line[0]] * waits + line)
        made.dwells_s.extend([dwell_s if list_mode else _whole_us(wait_s)] * waits + [dwell_s] * len(line))
        run_up = len(line) - (end - first)
        unused = waits + run_up
        made.numbers.extend(WAITING_NUMBER - len(made.index) - k for k in range(unused))
        made.numbers.extend(point.number for point in points[first:end])
        made.index.extend([-1] * unused + list(range(first, end)))
        first = end
    return Stepping(made.angles, made.dwells_s, made.numbers, made.index, 0.0, first)


def line_length(place: Angles, dwells_s: Sequence[float]) -> int:
    """How many points from the first on lie evenly on one straight line and have the same dwell."""
    if len(place) < 2 or dwells_s[1] != dwells_s[0]:
        return 1
    steps = np.diff(place, axis=0)
    change = np.hypot(*np.diff(steps, axis=0).T)
    uneven = change > EVEN * np.hypot(*steps[:-1].T)
    other = np.array([b != dwells_s[0] for b in dwells_s[2:]], dtype=np.bool_)
    breaks = np.flatnonzero(uneven | other)
    return int(breaks[0]) + 2 if len(breaks) else len(place)


def _check_pace(jump_s: float, line_s: float) -> None:
    if jump_s > line_s:
        raise LimitError(
            "mirror",
            f"cannot follow a line in {line_s * 1e3:.3g} ms that takes it {jump_s * 1e3:.3g} ms in one jump.",
            "Raise dwell_ms, scan a smaller wall, or take `continuous` out of the scan file.",
        )


def _line(place: Angles, lag: float) -> list[MirrorAngles]:
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
