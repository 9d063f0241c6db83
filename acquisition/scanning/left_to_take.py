"""Which points of a scan are still to be taken: those without a sample, those that failed, those put off until last."""

from itertools import islice

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.advice import Adviser, Batches
from nlos.drivers.bench import Bench
from nlos.drivers.errors import DeviceFault
from nlos.drivers.tcspc.counter import HistogramFlag

SPOILT = (
    HistogramFlag.SYNC_LOST
    | HistogramFlag.OVERRUN
    | HistogramFlag.TRIGGER_LATE
    | HistogramFlag.TRIGGER_MISSED
    | HistogramFlag.DATA_LOST
)
"""Flags of a point that is taken again."""
ATTEMPTS = 3
"""How often a point is taken before it is kept with its flags."""


class LeftToTake:
    """Of one scan under way. `photons`: point number -> photons of what an earlier recording holds. `adviser`: says
    which candidates come next, where the plan has more than it takes."""

    def __init__(self, plan: ScanPlan, bench: Bench, photons: dict[int, int], adviser: Adviser | None = None) -> None:
        self._plan, self._bench, self._photons = plan, bench, photons
        self._attempts: dict[int, int] = {}
        self._skipped: dict[int, int] = {}
        self._batches = None if plan.budget is None else Batches(plan, photons, adviser, bench.report)
        self._first, self._stuck = -1, 0
        self._done = 0
        """Every point before this one is taken."""
        self.first_pass_cut = False
        """Whether the first pass was ended early, in favour of the second."""

    def took(self, sample: Sample) -> None:
        """The sample is handed on."""
        photons = int(sample.histogram.counts.sum()) if self._plan.revisit_below is not None else 0
        self._photons[sample.point.number] = photons

    def postpone(self, number: int) -> bool:
        """Puts a point off until all others are taken; False where that was done often enough."""
        times = self._skipped.get(number, 0) + 1
        if times < ATTEMPTS:
            self._skipped[number] = times
        return times < ATTEMPTS

    def forget_first(self) -> None:
        """That the same point comes first again is no lack of progress."""
        self._first = -1

    def check_progress(self, first: int) -> None:
        """Before a batch: ends a scan that comes back to the same point again and again. Raises `DeviceFault`."""
        self._stuck = self._stuck + 1 if first == self._first else 0
        self._first = first
        if self._stuck >= ATTEMPTS:
            raise DeviceFault(
                self._bench.mirror.identity.model,
                f"its steps and the counter's points disagreed {ATTEMPTS} times from point {first} on.",
                "Check trigger and marker wires, or scan point by point.",
            )

    def is_taken_again(self, sample: Sample) -> bool:
        """Whether the point is to be taken once more."""
        return bool(sample.histogram.flags & SPOILT) and self._attempts.get(sample.point.number, 0) + 1 < ATTEMPTS

    def is_spoilt(self, sample: Sample) -> bool:
        """The same, counted, and said in the event log either way."""
        flags = sample.histogram.flags & SPOILT
        if not flags:
            return False
        number = sample.point.number
        again = self.is_taken_again(sample)
        attempt = self._attempts[number] = self._attempts.get(number, 0) + 1
        verdict = "is taken again" if again else f"is kept as it is after {attempt} attempts"
        self._bench.report("sample", f"point {number} {verdict}: {flags.name}")
        return again

    def numbers(self, most: int) -> list[int]:
        """What is still to take, in order, `most` of it; points that an alarm skipped come last."""
        photons = self._photons
        if self._batches is not None:
            return self._batches.numbers(most, self._skipped)
        if self._plan.revisit_below is None and not self._skipped:
            # Of many frames only what comes next is looked at: the others cost no time between two sequences.
            while self._done < len(self._plan) and self._done in photons:
                self._done += 1
            open_ = (number for number in range(self._done, len(self._plan)) if number not in photons)
            return list(islice(open_, most))
        todo = self._plan.pending(photons, self.first_pass_cut)
        if self._skipped:
            todo.sort(key=lambda number: self._skipped.get(number, 0))
        return todo[:most]
