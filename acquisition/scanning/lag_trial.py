"""Sweeps some lines of a plan there and back on the bench itself, and says by how much its mirror trails a ramp.

Half of each line is swept both ways too: there the mirror is younger on its ramp. Where the two answers differ, it is
not trailing by a constant lag - it is slower than the line, or the run-up too short.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.scanning import clocked
from nlos.acquisition.scanning.alarms import Trouble
from nlos.acquisition.scanning.clocked import Settle, Stepping
from nlos.acquisition.scanning.control import until_interrupted
from nlos.acquisition.scanning.lag import SIGMAS, Lag, Shift, combined, shift
from nlos.acquisition.scanning.light_watch import LightOff, LightWatch
from nlos.acquisition.scanning.sweeping import SETTLED, LineRefused, Lines, append_line, too_long
from nlos.acquisition.scanning.under_way import UnderWay
from nlos.drivers.bench import Bench
from nlos.drivers.errors import DeviceFault, LimitError
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.tcspc.counter import WAITING_NUMBER, HistogramFlag

USUAL = 5
"""How many sequences a measurement usually takes: what a forecast counts."""
LEAST, MOST = 2, 16
"""How many it takes at least, and at most."""
HOPELESS_AFTER = 3
"""So many sequences on, no light at all, or a lag that surely grows along a line, ends a measurement."""
ATTEMPTS = 3
FASTER = 1.1
"""How much faster than the scan the lines of a measurement are swept: a mirror that follows them has speed to spare."""
LEAST_POINTS = 16
PARALLEL = math.radians(10.0)
"""How much the directions of a plan's lines may differ: a lag is measured along one of them."""
TRIAL_NUMBER = 0xF000_0000
"""Counting down from here, the numbers of the points at which the lag is measured."""

Numbers = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Trial:
    """One sequence of it: `ways` are the numbers of the plan's points in the order swept, always there, then back."""

    made: Stepping
    points: list[ScanPoint]
    ways: list[Numbers]


def first_guess_s(lines: Lines, settle: Settle) -> float:
    """Half the settling time of one step: a servo that settles to a few per cent in it trails a ramp by that."""
    first = _swept(lines)[0]
    return settle(MirrorAngles(*lines.place[first]), MirrorAngles(*lines.place[first + 1])) / 2


def trial_dwell_s(lines: Lines) -> float:
    """The dwell of the points of a measurement, in whole microseconds."""
    return max(math.floor(float(lines.dwell_s[_swept(lines)[0]]) * 1e6 / FASTER), 1) * 1e-6


def trial(plan: ScanPlan, lines: Lines, settle: Settle, most: int, list_mode: bool, turn: int) -> Trial:
    """The `turn`-th sequence: as many lines as fit, spread over the plan, others every time. Raises `LineRefused` for
    lines that no sequence holds, or a plan whose lines cannot be measured."""
    firsts = _swept(lines)
    made, points, ways = Stepping([], [], [], [], 0.0, 0), list[ScanPoint](), list[Numbers]()
    dwell_s = trial_dwell_s(lines)
    stride = max(1, round(len(firsts) * 0.382))  # neighbouring turns take lines far apart
    for k in range(len(firsts)):
        first = firsts[(turn + k) * stride % len(firsts)]
        whole = np.arange(first, lines.end[first])
        half = whole[len(whole) // 2 :]
        longer, more = made, list[Numbers]()
        for way in (whole, whole[::-1], half, half[::-1]):
            index = list(range(len(points) + sum(map(len, more)), len(points) + sum(map(len, more)) + len(way)))
            longer = append_line(longer, lines.along(way, settle, dwell_s), index, dwell_s, settle, list_mode)
            more.append(way)
        if len(longer.index) > most:
            if not ways:
                raise too_long(most, 3 * len(whole), len(longer.index))
            break
        for number in np.concatenate(more).tolist():
            stamp = TRIAL_NUMBER - turn * most - len(points)
            points.append(replace(plan[number], number=stamp, row=None, col=None, dwell_s=dwell_s))
        made, ways = longer, [*ways, *more]
    numbers = [points[k].number if k >= 0 else WAITING_NUMBER - e for e, k in enumerate(made.index)]
    return Trial(replace(made, numbers=numbers, count=len(points)), points, ways)


class TrialEnded(Exception):
    """An alarm is raised; the shutter is closed."""

    def __init__(self, trouble: Trouble) -> None:
        super().__init__(trouble.text)
        self.trouble = trouble


def measure(
    plan: ScanPlan,
    bench: Bench,
    lines: Lines,
    under_way: UnderWay,
) -> Lag | None:
    """The lag of the plan's lines on this bench, with a bound in steps of a line of at most `plan.within_px`; None
    where a pause is wanted. The counter must be configured; the shutter is left to the caller to close. Raises
    `TrialEnded` where one of the scan's alarms stands; `LineRefused`, with the lag as far as it is known, where lines
    that lead by it cannot be swept, the mirror does not follow them as closely as that, or there is too little light to
    tell; `LimitError` where its table of settling times cannot be right."""
    found = [Lag(math.nan, math.inf)]
    try:
        return _measure(plan, bench, lines, under_way, found)
    except LineRefused as error:
        error.lag = replace(found[-1], refused=error.what)
        raise


def _measure(plan: ScanPlan, bench: Bench, lines: Lines, under_way: UnderWay, found: list[Lag]) -> Lag | None:
    """As `measure`; what is known after each sequence is appended to `found`."""
    within_px = plan.within_px
    assert within_px is not None
    dwell_s = trial_dwell_s(lines)
    bench.counter.check(plan.axis, dwell_s)
    lines.lag_s = first_guess_s(lines, bench.mirror.settle_s)
    settled_s = 2 * lines.lag_s
    whole, half = list[Shift](), list[Shift]()
    bound = math.inf
    for turn in range(MOST):
        samples = _swept_there_and_back(plan, bench, lines, under_way, turn)
        if samples is None:
            return None
        ahead, young = samples
        if turn == 0:  # only to come near: a small shift is found without a doubt about the curve's shape
            lines.lag_s -= combined(ahead).points * dwell_s
            continue
        lead = lines.lag_s / dwell_s
        whole += [replace(each, points=lead - each.points) for each in ahead]
        half += [replace(each, points=lead - each.points) for each in young]
        lag, early = combined(whole), combined(half)
        # Half a line is on average half as old as a whole one: what grows along a line does so twice as much.
        growth, doubt = abs(early.points - lag.points), math.hypot(early.error, lag.error)
        bound = SIGMAS * lag.error + 2 * (growth + 2 * doubt)
        found.append(Lag(lag.points * dwell_s if math.isfinite(lag.error) else math.nan, bound))
        if bound <= within_px:
            if found[-1].lag_s > settled_s:
                raise _slower_than_its_table(found[-1].lag_s, settled_s)
            return found[-1]
        if turn > HOPELESS_AFTER and (not math.isfinite(bound) or 2 * (growth - 4 * doubt) > within_px):
            break
    known = "no light says where the beam is"
    if math.isfinite(bound):
        trails = f"trails by {found[-1].lag_s * 1e3:.3g} ms"
        known = f"the beam {trails} and is known to be within {bound:.2g} pixels of its points"
    raise LineRefused(
        "mirror",
        f"on continuous lines {known} after {turn + 1} sequences swept there and back; the plan asks for "
        f"{within_px:g}.",
        "Let more light from the wall into the histogram, or: " + SETTLED,
    )


def _slower_than_its_table(lag_s: float, settled_s: float) -> LimitError:
    """Run-ups and waits rest on the table of settling times."""
    return LimitError(
        "mirror",
        f"trails continuous lines by {lag_s * 1e3:.3g} ms, and its table says that it settles in {settled_s * 1e3:.3g} "
        "ms.",
        "Measure `settle` again for the bench file, or take `continuous` out of the scan file.",
    )


def _swept_there_and_back(
    plan: ScanPlan,
    bench: Bench,
    lines: Lines,
    under_way: UnderWay,
    turn: int,
) -> tuple[list[Shift], list[Shift]] | None:
    """(of whole lines, of halves), or None where a pause is wanted. Raises `DeviceFault` where steps and points do not
    agree, `SafetyTrip` where there is too much light."""
    most = min(bench.mirror.max_sequence, bench.counter.max_points)
    wanted = trial(plan, lines, bench.mirror.settle_s, most, bench.counter.list_mode, turn)
    for _ in range(ATTEMPTS):
        samples = _unkept(bench, wanted, under_way)
        if under_way.control.wanted:
            return None
        spoilt = any(sample.histogram.flags & ~HistogramFlag.STOPPED_EARLY for sample in samples)
        if len(samples) == len(wanted.points) and not spoilt:
            break
    else:
        raise DeviceFault(
            bench.mirror.identity.model,
            f"its steps and the counter's points disagreed {ATTEMPTS} times while its lag was measured.",
            "Check trigger and marker wires, or scan point by point.",
        )
    counts = np.stack([sample.histogram.counts for sample in samples])
    swept = np.split(counts, np.cumsum([len(way) for way in wanted.ways])[:-1])
    found = [shift(there, back[::-1]) for there, back in zip(swept[::2], swept[1::2], strict=True)]
    return found[::2], found[1::2]


def _unkept(bench: Bench, wanted: Trial, under_way: UnderWay) -> list[Sample]:
    """Samples that no recording keeps, taken under the same watch as any others; fewer where something came between."""
    watch = LightWatch(bench, under_way.alarms, lambda sample: False, trial=True)
    bench.while_waiting = watch.look
    try:
        angles = wanted.made.angles[: len(wanted.points)]
        source = clocked.take(bench, wanted.points, angles, under_way, watch, lambda *_: wanted.made)
        samples = list(until_interrupted(source, under_way.control))
    except LightOff:
        samples = []  # while the batch was being armed: `watch` says why
    finally:
        bench.while_waiting = lambda: None
    if watch.trip is not None:
        raise watch.trip
    if watch.trouble is not None:
        raise TrialEnded(watch.trouble)
    return samples


def _swept(lines: Lines) -> list[int]:
    """The first points of the plan's longest lines. Raises `LineRefused` where they are too short to be measured, or
    not parallel to all others."""
    firsts = np.unique(lines.first)
    lengths = lines.end[firsts] - firsts
    if lengths.max() < LEAST_POINTS or lengths.min() < 2:
        raise LineRefused(
            "mirror",
            f"the plan's lines have {lengths.min()} to {lengths.max()} points; a lag is measured on lines of "
            f"{LEAST_POINTS} or more.",
            "Take `continuous` out of the scan file.",
        )
    steps = np.diff(lines.place, axis=0)[lines.first[1:] == lines.first[:-1]]
    direction = np.arctan2(steps[:, 1], steps[:, 0])
    apart = np.abs((direction - direction[0] + np.pi / 2) % np.pi - np.pi / 2)
    if apart.max() > PARALLEL:
        raise LineRefused(
            "mirror",
            "the plan's lines run in several directions; a lag is measured along one.",
            "Take `continuous` out of the scan file.",
        )
    return [int(first) for first in firsts[lengths == lengths.max()]]
