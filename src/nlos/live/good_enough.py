"""`scan --until sure`: ends a scan, or its first pass, once its picture's error is predicted to be small enough.

`--until stable` does so when the picture has stopped changing and holds light enough, which any method can say. The
picture is made again whenever a quarter more points are in, so that "change" always means the same: what a quarter more
of the scan did to it. On a simulated bench that happens between two points, at the same points in every
run; on a real one the live process makes the pictures, and only its figures are read here, twice a second.
"""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.cli.exit_codes import UsageError
from nlos.live.looks import Looks, catch_up
from nlos.live.process import read_state, state_file
from nlos.recipe import Recipe
from nlos.recon.live import GROWTH

if TYPE_CHECKING:
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.sample import Sample
    from nlos.loaded import LoadedScan

METHOD = "nano"
SURE, STABLE = "sure", "stable"
LEVELS = {SURE: 0.35, STABLE: 0.05}
FIRST_FRACTION = 0.05
AGAIN_S = 0.5


@dataclass(frozen=True)
class Goal:
    """When a picture is good enough: `sure`, its relative error is below `level` in nine cases of ten; `stable`, change
    and photon noise are."""

    word: str
    level: float

    def verdict(self, figures: Mapping[str, float | None]) -> tuple[bool, str]:
        """Whether `change`, `error` (photon noise) and `bound` of a picture reach it, and these in words."""
        if self.word == SURE:
            bound = figures["bound"]
            said = "no method here says how far it is off" if bound is None else f"error below {bound:.4f}"
            return bound is not None and bound <= self.level, said
        change, error = figures["change"], figures["error"]
        assert change is not None
        assert error is not None
        return max(change, error) <= self.level, f"change {change:.4f}, photon noise {error:.4f}"


_Figures = tuple[int, dict[str, float | None]]
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
        self._goal, self._report = goal, report
        self._state = None if watched is None else state_file(watched)
        self._looks = Looks(plan, nothing_yet, recipe, report)
        self._next = max(1, math.ceil(FIRST_FRACTION * plan.most_samples))
        self._looked_s = -math.inf
        self._seen = 0

    def catch_up(self, run: Path) -> None:
        """Takes in what a recording that is resumed holds, before it is opened for writing."""
        catch_up(self.add, run)

    def add(self, sample: "Sample") -> None:
        """One more sample, once it is on its way to the disk."""
        if self._state is None:
            self._looks.add(sample)

    def __call__(self) -> bool:
        """Whether the scan may end now; said in the event log with its figures."""
        figures = self._computed() if self._state is None else self._polled()
        if figures is None:
            return False
        samples, found = figures
        enough, said = self._goal.verdict(found)
        self.reached |= enough
        self.said = f"{said}, level {self._goal.level:g}"
        verdict = "is good enough" if enough else "is not good enough yet"
        self._report("until", f"the picture of {samples} points {verdict}: {self.said}")
        return enough

    def _computed(self) -> _Figures | None:
        if len(self._looks) < self._next:
            return None
        self._next = math.ceil(self._growth * self._next)
        picture = self._looks.picture("until")
        if picture is None:
            return None
        return picture.samples, {"change": picture.change, "error": picture.error, "bound": picture.bound}

    def _polled(self) -> _Figures | None:
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
        return samples, {**figures, "bound": bound if isinstance(bound, float) else None}


def parse_until(word: str) -> Goal:
    """The goal `sure`, `stable`, or either with `:LEVEL`. Raises `UsageError`."""
    kind, colon, text = word.partition(":")
    if kind in LEVELS and not colon:
        return Goal(kind, LEVELS[kind])
    try:
        level = float(text)
    except ValueError:
        level = math.nan
    if kind not in LEVELS or not 0 < level < 1:
        raise UsageError(
            f"--until {word}: `sure` or `stable`, either with a level between 0 and 1, e.g. sure:0.2 or stable:0.1"
        )
    return Goal(kind, level)


def check_sure(method: str, weights: object) -> None:
    """That pictures by `method` say how far they are off. Raises `UsageError`."""
    from nlos.recon.intervals import head_for

    if method != METHOD or head_for(str(weights or METHOD)) is None:
        raise UsageError(
            f"--until sure: pictures by {method}{' with these weights' if weights else ''} do not say how far they may "
            f"be off. Use --reconstruct {METHOD} with the weights that ship, or --until stable."
        )
