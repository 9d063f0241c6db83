"""Schemes S2 and S3: a clock steps the mirror, the counter's or its own, and the host uploads, watches, reads blocks.

The mirror's marker edges are counted against the points. A block is handed on once the status after the next one agrees
as well; where they disagree, everything since then is taken again.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.scanning.light_watch import LightOff, LightWatch
from nlos.acquisition.scanning.under_way import UnderWay
from nlos.drivers.bench import Bench
from nlos.drivers.galvo.mirror import MirrorAngles, OwnClock, OwnSteps, own_clock
from nlos.drivers.tcspc.counter import WAITING_NUMBER, CounterStatus, HistogramFlag, PointGates, Trigger

BLOCK_S = 0.1
"""How long a block of points lasts: how often the watchdog is kicked, samples are judged and a pause is noticed."""
BLOCK_POINTS = 64
"""Read while the others are taken, so that little is left to read when the sequence ends."""
GRACE_S = 2.0
SEGMENT_US = 80_000
"""What starting another sequence costs, roughly: it decides whether a jump is worth a sequence of its own."""
ENTRY_US = 100
"""What one more entry of a sequence costs: its upload, and its share of the next sequence's start."""
LOOKS = 3
_AGAIN = "what is not confirmed is taken again"

Settle = Callable[[MirrorAngles, MirrorAngles], float]
Sequencer = Callable[[Sequence[ScanPoint], Sequence[MirrorAngles], Settle, int, bool], "Stepping"]
"""(points, their angles, settling time of a move, most entries, list mode) -> the next sequence"""


@dataclass(frozen=True)
class Stepping:
    """One sequence: what the mirror steps through and the counter times. `index[i]` is the point that entry i
    measures, -1 where it waits for the mirror after a jump; `count` points are in it."""

    angles: list[MirrorAngles]
    dwells_s: list[float]
    numbers: list[int]
    index: list[int]
    blanking_s: float
    count: int
    own: OwnSteps | None = None
    """The pace of a mirror with a clock of its own."""

    @property
    def duration_s(self) -> float:
        """From the first step's command to the end of the last dwell."""
        if self.own is not None:
            return self.own.first_s + len(self.dwells_s) * self.own.step_s
        return sum(self.dwells_s) + len(self.dwells_s) * self.blanking_s


def stepping(
    points: Sequence[ScanPoint], angles: Sequence[MirrorAngles], settle: Settle, most: int, list_mode: bool
) -> Stepping:
    """As many of `points` as fit `most` entries. Blanking is the same after every step, so it is chosen for the least
    time in all, and a step that needs longer gets entries that only wait; in list mode, whose clock has one period,
    such a step or another dwell ends the sequence instead."""
    points, angles = points[:most], angles[:most]
    moves_us = [0, *(_whole_us(settle(a, b)) for a, b in pairwise(angles))]
    blanking_us = best_blanking_us(np.array(moves_us), SEGMENT_US if list_mode else ENTRY_US)
    blanking_s = blanking_us * 1e-6
    made = Stepping([], [], [], [], blanking_s, len(points))
    for i, (point, target, move_us) in enumerate(zip(points, angles, moves_us, strict=True)):
        jump = move_us > blanking_us
        if list_mode and i and (jump or point.dwell_s != points[0].dwell_s):
            return Stepping(made.angles, made.dwells_s, made.numbers, made.index, blanking_s, i)
        if len(made.index) + 1 + jump > most:
            return Stepping(made.angles, made.dwells_s, made.numbers, made.index, blanking_s, i)
        if jump:
            made.angles.append(target)
            made.dwells_s.append(max(move_us - 2 * blanking_us, 1) * 1e-6)
            made.numbers.append(WAITING_NUMBER - i)
            made.index.append(-1)
        made.angles.append(target)
        made.dwells_s.append(point.dwell_s)
        made.numbers.append(point.number)
        made.index.append(i)
    return made


def next_sequence(
    bench: Bench, points: Sequence[ScanPoint], angles: Sequence[MirrorAngles], sequencer: Sequencer
) -> Stepping:
    """The next sequence of these points that mirror and counter hold; steps by a mirror's own clock are all alike, as
    in list mode. Raises `LimitError` for a dwell that its clock does not make."""
    mirror, counter = bench.mirror, bench.counter
    own = own_clock(mirror)
    held = mirror.max_sequence if own is None else own.most_steps(points[0].dwell_s)
    most = min(held, counter.max_points)
    plan = sequencer(points[:most], angles[:most], mirror.settle_s, most, counter.list_mode or own is not None)
    return plan if own is None else at_own_pace(plan, own)


def at_own_pace(plan: Stepping, own: OwnClock) -> Stepping:
    """The same sequence, blanked for as long as the mirror's clock leaves before each dwell."""
    steps = own.own_steps(plan.dwells_s[0], plan.blanking_s)
    return replace(plan, blanking_s=steps.blanking_s, own=steps)


def best_blanking_us(moves_us: npt.NDArray[np.int64], jump_us: int) -> int:
    """The blanking with the least total time: steps that settle within it cost it, longer ones cost themselves (at
    least twice the blanking) and `jump_us`."""
    candidates = np.unique(np.quantile(moves_us, np.linspace(0.0, 1.0, 33), method="higher"))
    costs = [
        np.where(moves_us <= each, each, np.maximum(moves_us, 2 * each + 1) + jump_us).sum() for each in candidates
    ]
    return int(candidates[int(np.argmin(costs))])


def _whole_us(seconds: float) -> int:
    return math.ceil(round(seconds * 1e6, 3))


def take(
    bench: Bench,
    points: Sequence[ScanPoint],
    angles: Sequence[MirrorAngles],
    under_way: UnderWay,
    watch: LightWatch,
    sequencer: Sequencer = stepping,
) -> Iterator[Sample]:
    """Takes as many of `points` as one sequence holds; the counter must be configured. Ends early once a
    pause is wanted, the markers disagree or `watch` has shut off the light. The shutter is opened here and left to the
    caller to close."""
    mirror, counter, clock, control = bench.mirror, bench.counter, bench.clock, under_way.control
    plan = next_sequence(bench, points, angles, sequencer)
    counter.abort()  # where the sequence before was given up, its clock still runs
    mirror.stop()
    if not bench.shutter.may_be_open:  # else the beam would go there from where it is parked in the light
        mirror.move_to(plan.angles[0])
    own = own_clock(mirror)
    if own is None or plan.own is None:
        mirror.load(plan.angles)
    else:
        own.load_steps(plan.angles, plan.own)
    bench.shutter.open()
    mirror.start()
    armed_s = clock.now() - under_way.start_s
    bench.announce(plan.numbers, plan.angles)
    if own is None or plan.own is None:
        counter.arm(PointGates(plan.dwells_s, plan.numbers, Trigger.CLOCK, plan.blanking_s))
    else:
        counter.arm(PointGates(plan.dwells_s, plan.numbers, Trigger.MIRROR, plan.blanking_s, plan.own.step_s))
        own.play()
    entries = len(plan.index)
    block = max(1, min(round(entries * BLOCK_S / plan.duration_s), BLOCK_POINTS))
    held: list[Sample] = []
    for first in range(0, entries, block):
        count = min(block, entries - first)
        span_s = sum(plan.dwells_s[first : first + count]) + count * plan.blanking_s
        if (due := next((k for k in plan.index[first : first + count] if k >= 0), None)) is not None:
            watch.awaits(points[due].number)
        try:
            status = counter.wait_points(first + count, timeout_s=span_s + GRACE_S)
        except LightOff:
            yield from held
            return
        if control.wanted:
            return
        if not _markers_agree(bench, status):
            bench.report(
                "sample",
                f"{status.markers} mirror steps for {status.points_done} of {entries} points from "
                f"{points[0].number}: {_AGAIN}",
            )
            return
        histograms = counter.read(first, count)
        if any(each.flags & HistogramFlag.TRIGGER_MISSED for each in histograms):
            # The mirror may have followed one that the counter overlooked, and so made up for one it missed itself.
            bench.report("sample", f"the counter missed a step after point {points[0].number}: {_AGAIN}")
            yield from held
            return
        taken = [
            Sample(points[plan.index[entry]], histogram, armed_s + histogram.gate_opened_s)
            for entry, histogram in enumerate(histograms, first)
            if plan.index[entry] >= 0
        ]
        try:
            watch.inspect(taken)
        except LightOff:
            yield from held
            return
        yield from held
        held = taken
        if span_s > BLOCK_S:  # long points do not wait for the next one to be confirmed
            if not _markers_agree(bench, counter.wait_points(first + count, timeout_s=GRACE_S)):
                return
            yield from held
            held = []
    mirror.stop()
    yield from held


def _markers_agree(bench: Bench, status: CounterStatus) -> bool:
    """Whether the mirror made as many steps as were due. The two numbers are not read at the same instant, so a step
    that came in between is looked at again."""
    for _ in range(LOOKS):
        if status.markers is None or status.markers == status.steps_due:
            return True
        status = bench.counter.wait_points(status.points_done, timeout_s=GRACE_S)
    return False
