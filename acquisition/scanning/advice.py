"""Which candidates of a plan come next: as somebody advises who has looked at what there is, else coarse to fine.

Nobody is waited for. Each batch leaves a line in the event log that says from which sample on it was taken, and why.
"""

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from nlos.acquisition.planning.plan import ScanPlan

PROBE = 32
"""Points that are taken without advice before it is asked for again."""
REASON = "batch"
"""The kind of such a line."""
UNADVISED, LATE = "coarse to fine", "coarse to fine: no advice in time"
_LINE = re.compile(r"from sample (\d+): (\d+) points of ([0-9.e+-]+) ms, (.*)")


@dataclass(frozen=True)
class Advice:
    """`numbers` of a plan, the most wanted first, and `why` in a few words."""

    numbers: Sequence[int]
    why: str


class Adviser(Protocol):
    """Whoever knows what helps; whatever takes time it does elsewhere."""

    def advise(self, taken: Collection[int], left_us: int) -> Advice | None:
        """At once: what should come next, of what is not `taken`, in the time that is left; None without an idea."""
        ...


class Batches:
    """The batches of one scan. `photons`: of the samples so far, by point number; read, never changed."""

    def __init__(
        self,
        plan: ScanPlan,
        photons: Collection[int],
        adviser: Adviser | None,
        report: Callable[[str, str], None],
    ) -> None:
        assert plan.budget is not None
        self._plan, self._photons, self._adviser, self._report = plan, photons, adviser, report
        self._budget, self._costs_us = plan.budget, plan.budget.costs_us(plan.dwell_s)
        self._batch: list[int] = []

    def numbers(self, most: int, last: Collection[int] = ()) -> list[int]:
        """What is left of this batch, else the next one, at most `most` of it; points in `last` come after all others.
        Empty once the next in the plan's order does not fit into the time."""
        left = [number for number in self._batch if number not in self._photons and number not in last]
        if not left:
            left = self._batch = self._next(last)
        return left[:most]

    def _next(self, last: Collection[int]) -> list[int]:
        left_us = self._plan.left_us(self._photons)
        open_ = [number for number in range(len(self._plan)) if number not in self._photons]
        if not open_ or self._costs_us[open_[0]] > left_us:
            return []
        if self._budget.after_first and self._plan.pass_[open_[0]] == 0:
            first = [number for number in open_ if self._plan.pass_[number] == 0]
            self._say(first, "the first pass")
            return first
        chosen = self._advised(left_us, last)
        if chosen is None:
            open_.sort(key=lambda number: number in last)  # which keeps the order of the others
            chosen = Advice(open_, UNADVISED) if self._adviser is None else Advice(open_[:PROBE], LATE)
        numbers, why = list(chosen.numbers[: self._budget.batch]), chosen.why
        numbers = numbers[: self._budget.first(self._costs_us[numbers], left_us)]
        self._say(numbers, why)
        return [int(number) for number in self._plan.on_path(np.array(numbers, dtype=np.intp))]

    def _say(self, numbers: Sequence[int], why: str) -> None:
        dwell_ms = float(self._plan.dwell_s[list(numbers)].max()) * 1e3
        self._report(REASON, f"from sample {len(self._photons)}: {len(numbers)} points of {dwell_ms:.6g} ms, {why}")

    def _advised(self, left_us: int, last: Collection[int]) -> Advice | None:
        """The advice, where there is one that can be taken; what cannot is said in the event log."""
        if self._adviser is None:
            return None
        try:
            advice = self._adviser.advise(self._photons, left_us)
        except Exception as error:  # whoever advises is no part of the scan, and ends none
            self._report("advice", f"none: {type(error).__name__}: {error}")
            return None
        if advice is None:
            return None
        if fault := self._fault(advice.numbers, left_us):
            self._report("advice", f"refused ({advice.why}): {fault}")
            return None
        wanted = [number for number in advice.numbers if number not in last]
        return Advice(wanted, advice.why) if wanted else None

    def _fault(self, numbers: Sequence[int], left_us: int) -> str:
        if not len(numbers):
            return "it names no point"
        for number in numbers:
            if not isinstance(number, int) or not 0 <= number < len(self._plan):
                return f"point {number} of a plan of {len(self._plan)}"
            if number in self._photons:
                return f"point {number} is taken already"
        if len(set(numbers)) < len(numbers):
            return "it names a point twice"
        if len(set(self._plan.pass_[list(numbers)].tolist())) > 1:
            return "its points have different dwells"
        if self._costs_us[numbers[0]] > left_us:
            return "there is no time for it"
        return ""


@dataclass(frozen=True)
class Reason:
    """Why the samples from number `first` on were taken, `count` of them, with this dwell."""

    first: int
    count: int
    dwell_s: float
    why: str

    @property
    def word(self) -> str:
        """What is before the colon of `why`: how the places were chosen."""
        return self.why.partition(":")[0]


def reasons(events: Iterable[tuple[str, str]], samples: int) -> list[Reason]:
    """What the event log, (kind, text) of each line, says of so many samples. A batch that was begun again after a
    crash counts as what became of it."""
    found: list[Reason] = []
    for kind, text in events:
        if kind != REASON or (line := _LINE.fullmatch(text)) is None:
            continue
        first = int(line[1])
        while found and found[-1].first >= first:
            found.pop()
        found.append(Reason(first, int(line[2]), float(line[3]) * 1e-3, line[4]))
    ends = [*(reason.first for reason in found[1:]), samples]
    return [
        Reason(each.first, min(end, samples) - each.first, each.dwell_s, each.why)
        for each, end in zip(found, ends, strict=True)
        if each.first < samples
    ]
