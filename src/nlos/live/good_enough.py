"""`scan --until sure`: ends a scan, or its first pass, once its picture's error is predicted to be small enough.

`--until stable` does so when the picture has stopped changing and holds light enough, which any method can say. The
picture is made again whenever a quarter more points are in, so that "change" always means the same: what a quarter more
of the scan did to it. On a simulated bench that happens between two points, at the same points in every
run; on a real one the live process makes the pictures, and only its figures are read here, twice a second. Where a scan
is resumed that process begins anew, and the pictures that are missing are waited for in the dark.
"""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.recording.recording import Recording
from nlos.cli.exit_codes import UsageError
from nlos.live.goal import Figures, Goal
from nlos.live.looks import Looks
from nlos.live.looks_before import KIND, ending, look_text, looks_before
from nlos.live.process import read_state, state_file
from nlos.recipe import Recipe
from nlos.recon.live import GROWTH

if TYPE_CHECKING:
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.sample import Sample
    from nlos.loaded import LoadedScan

METHOD = "nano"
FIRST_FRACTION = 0.05
AGAIN_S, LOOK_S = 0.5, 0.05
LONGEST_S = 120.0
"""For the pictures that the live process makes in the dark: a library, and two of the slowest method."""

_Seen = tuple[int, Figures]
"""Samples, and what `Goal.verdict` asks for."""


class Enough:
    """The engine's `decide`: fed with every sample, asked after every one."""

    def __init__(
        self,
        plan: "ScanPlan",
        nothing_yet: "LoadedScan",
        goal: Goal,
        recipe: Recipe,
        report: Callable[[str, str], None],
        watched: Path | None = None,
    ) -> None:
        """`nothing_yet`: the scan as it is loaded, without samples. `watched`: the recording whose live process makes
        the pictures; its figures are read here."""
        self._growth = GROWTH
        self.reached = False
        """Whether the scan, or the first of its passes, ended for being good enough."""
        self.said = ""
        """What was found at the last look."""
        self.decided: list[int] = []
        """Of a scan that is resumed: after how many of its samples the picture was good enough."""
        self._method = recipe.method
        self._bound = math.inf
        self._goal, self._report = goal, report
        self._state = None if watched is None else state_file(watched)
        self._looks = Looks(plan, nothing_yet, recipe, report)
        self._next = max(1, math.ceil(FIRST_FRACTION * plan.most_samples))
        self._looked_s = -math.inf
        self._seen = 0
        self.before = 0
        """Of a real bench's scan that is resumed: the live process first makes a picture of so many samples."""
        self._awaited = 0

    def catch_up(self, run: Path) -> None:
        """Takes in what a recording that is resumed holds, before it is opened for writing: its samples, and what was
        decided after them. The newest picture is made again, for the next one is compared with it."""
        with Recording.open(run) as recording:
            looks = looks_before(recording, self._goal, self._method)
            last = looks[-1] if looks else None
            over = ending(recording, looks) is not None
            for number, sample in enumerate(recording.samples(), 1):
                self.add(sample)
                if last is not None and number == last.samples and self._state is None and not over:
                    self._looks.picture(KIND)
            held = len(recording.intact_records())
        self.decided = [look.samples for look in looks if look.enough]
        self.reached = bool(self.decided)
        if last is not None:
            self.said, self._seen = last.said, last.samples
            self._bound = last.bound or math.inf
        earliest = self._next if last is None else last.samples
        if self._state is not None and not over:
            if held >= self._growth * earliest:  # the next look was due
                self.before, self._awaited = int(held / self._growth), held
            elif last is not None:
                self.before = self._awaited = last.samples
        while self._next < held if last is None else self._next <= last.samples:
            self._next = math.ceil(self._growth * self._next)

    def add(self, sample: "Sample") -> None:
        """One more sample, once it is on its way to the disk."""
        if self._state is None:
            self._looks.add(sample)

    def wait_in_the_dark(self, comes: Callable[[], bool]) -> bool:
        """Until the live process has made the picture that the next ones are compared with, and that of all the scan
        holds where it was due as the scan was broken off. False where they do not come, as `comes` says, or not within
        `LONGEST_S`: then a quarter more points are taken before anything is decided."""
        until_s = time.monotonic() + LONGEST_S
        while self._state is not None and not self._there(self._state):
            if not comes() or time.monotonic() > until_s:
                return False
            time.sleep(LOOK_S)
        return True

    def _there(self, state: Path) -> bool:
        samples = read_state(state).get("samples") if self._awaited else 0
        return isinstance(samples, int) and samples >= self._awaited

    def __call__(self) -> bool:
        """Whether the scan may end now; said in the event log with its figures."""
        figures = self._computed() if self._state is None else self._polled()
        if figures is None:
            return False
        samples, found = figures
        enough, said = self._goal.verdict(found)
        self.reached |= enough
        self.said = f"{said}, level {self._goal.level:g}"
        self._report(KIND, look_text(samples, self._method, enough, self.said))
        return enough

    def _computed(self) -> _Seen | None:
        if len(self._looks) < self._next:
            return None
        self._next = math.ceil(self._growth * self._next)
        picture = self._looks.picture(KIND)
        if picture is None:
            return None
        return picture.samples, self._figures(picture.change, picture.error, picture.bound)

    def _polled(self) -> _Seen | None:
        assert self._state is not None
        if time.monotonic() - self._looked_s < AGAIN_S:
            return None
        self._looked_s = time.monotonic()
        found = read_state(self._state)
        samples, bound = found.get("samples"), found.get("bound")
        figures = {name: found.get(name) for name in ("change", "error")}
        if not isinstance(samples, int) or samples < self._growth * self._seen:
            return None
        if not all(isinstance(value, float) for value in figures.values()):
            return None
        self._seen = samples
        return samples, self._figures(figures["change"], figures["error"], bound if isinstance(bound, float) else None)

    def _figures(self, change: float | None, error: float | None, bound: float | None) -> Figures:
        """The bound is the least so far, of what a recording that is resumed had, too."""
        return {"change": change, "error": error, "bound": None if bound is None else min(bound, self._bound)}


def check_sure(method: str, weights: object) -> None:
    """That pictures by `method` say how far they are off. Raises `UsageError`."""
    from nlos.recon.intervals import head_for

    if method != METHOD or head_for(str(weights or METHOD)) is None:
        raise UsageError(
            f"--until sure: pictures by {method}{' with these weights' if weights else ''} do not say how far they may "
            f"be off. Use --reconstruct {METHOD} with the weights that ship, or --until stable."
        )
