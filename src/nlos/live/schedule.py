"""When to make a picture, by which method, and when the next one will be there."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from nlos.acquisition.planning.plan import ScanPlan
from nlos.live.pace import Pace

QUICK_AFTER_S = 8.0
"""The quicker method keeps making pictures in passing where the best one takes longer than this."""
EVERY_S = 2.0
ROOM = 1.5
"""A picture in passing is begun where at least so many times as long as it takes is left of the scan."""


@dataclass(frozen=True)
class Coming:
    """The next picture: being made, or due; `in_s` None where nobody can tell (no samples come)."""

    method: str
    samples: int
    making: bool
    in_s: float | None


class Schedule:
    """Methods in the order of their speed. The first one's picture comes first, and the last one's replaces it; what
    would not be ready before the last sample is left to the last, but for a film's frames, which follow each other. Of
    a finished recording there is one picture each."""

    def __init__(self, methods: Sequence[str], first_fraction: float, every_fraction: float = 0.05) -> None:
        """Of which part of the plan's points the first picture is, and how many more a new one is due after; a new one
        is due after `EVERY_S` as well."""
        self._methods, self._first_fraction, self._every_fraction = methods, first_fraction, every_fraction
        self._made: dict[str, int] = {}
        self._made_s: dict[str, float] = {}
        self.pace = Pace()
        self.skipped = 0
        """Pictures that were due while another was being made."""
        self._frame: int | None = None

    def follow_frames(self, plan: ScanPlan) -> None:
        """Of a film the first picture is of a whole scan, and a new one is due with every frame."""
        if plan.frames > 1:
            self._frame = max(1, len(plan) // plan.frames)
            self._first_fraction = plan.cycle / plan.frames

    def frame_s(self) -> float:
        """How long a frame of a film takes, as samples come; infinite while none do."""
        return self.pace.left_s(self._frame or 0, time.monotonic())

    def of(self, method: str) -> int:
        """Of how many samples the newest picture by `method` is; 0 where there is none."""
        return self._made.get(method, 0)

    def due(self, count: int, planned: int, growing: bool, last: bool) -> str | None:
        """The method whose picture is to be made now: of those that are due, the one that has waited longest."""
        waiting = [each for each in self._methods if self._is_due(each, count, planned, growing, last)]
        return min(waiting, key=lambda method: self._made_s.get(method, 0.0), default=None)

    def done(self, count: int) -> bool:
        """Whether every method has made its picture of so many samples."""
        return all(self.of(method) >= count for method in self._methods)

    def made(self, method: str, count: int, planned: int, seconds: float, growing: bool) -> None:
        """A picture of `count` samples was made, or could not be, after so many seconds."""
        self.begun(method, count, planned, growing)
        self.pace.took(method, seconds)

    def begun(self, method: str, count: int, planned: int, growing: bool) -> None:
        """One is being made: what is due next is reckoned from it, and not before."""
        if growing:
            self.skipped += max(0, (count - self.of(method)) // self._step(planned) - 1)
        self._made[method], self._made_s[method] = count, time.monotonic()

    def ending(self, count: int, planned: int, growing: bool) -> bool:
        """Whether what is left of a scan is too little for another picture, and enough to get ready for the last."""
        if not growing or not count:
            return False
        left_s, picture_s = self.pace.left_s(planned - count, time.monotonic()), self.pace.picture_s(self._methods[-1])
        return ROOM * picture_s >= left_s > picture_s / 3

    def coming(self, count: int, planned: int, growing: bool, last: bool) -> Coming:
        """The next picture of the quickest method."""
        method = self._methods[0]
        wanted = self.of(method) + self._step(planned) if self.of(method) else self._first(method, planned)
        if last or not growing or wanted >= planned:
            wanted = planned
        left_s = 0.0 if last else self.pace.left_s(max(wanted - count, 0), time.monotonic())
        in_s = left_s + self.pace.picture_s(method)
        return Coming(method, count if last else wanted, False, in_s if in_s < 1e6 else None)

    def _is_due(self, method: str, count: int, planned: int, growing: bool, last: bool) -> bool:
        best, made, now_s = self._methods[-1], self.of(method), time.monotonic()
        if last or not growing or not planned:
            return last and count > made
        if not made:
            return count >= self._first(method, planned)
        if method != best and self.of(best) and self.pace.picture_s(best) < QUICK_AFTER_S:
            return False
        late = count > made and now_s - self._made_s[method] >= EVERY_S
        ready = self._frame is not None or self.pace.left_s(planned - count, now_s) > ROOM * self.pace.picture_s(method)
        return ready and (count - made >= self._step(planned) or late)

    def _first(self, method: str, planned: int) -> int:
        """A slower method follows the quickest one's first picture."""
        if method != self._methods[0] and not self.of(self._methods[0]):
            return planned + 1
        return max(1, int(self._first_fraction * planned))

    def _step(self, planned: int) -> int:
        return self._frame or max(1, int(self._every_fraction * planned))
