"""What a scan may end by: how good its picture is to be."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from nlos.cli.exit_codes import UsageError

SURE, STABLE = "sure", "stable"
LEVELS = {SURE: 0.35, STABLE: 0.05}

Figures = Mapping[str, float | None]
"""`change`, `error` (photon noise) and `bound` of a picture."""


@dataclass(frozen=True)
class Goal:
    """When a picture is good enough: `sure`, its relative error is below `level` in nine cases of ten; `stable`, change
    and photon noise are."""

    word: str
    level: float

    def can_judge(self, figures: Figures) -> bool:
        """Whether these are the figures that it asks for."""
        asked = ("bound",) if self.word == SURE else ("change", "error")
        return all(figures[name] is not None for name in asked)

    def verdict(self, figures: Figures) -> tuple[bool, str]:
        """Whether a picture's figures reach it, and these in words."""
        if self.word == SURE:
            bound = figures["bound"]
            said = "no method here says how far it is off" if bound is None else f"error below {bound:.4f}"
            return bound is not None and bound <= self.level, said
        change, error = figures["change"], figures["error"]
        assert change is not None
        assert error is not None
        return max(change, error) <= self.level, f"change {change:.4f}, photon noise {error:.4f}"


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
