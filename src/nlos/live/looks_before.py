"""What a recording says of the pictures that were judged while it was taken: what was decided then stands on a resume.

Each look is a line of the event log. What a goal of another level makes of it follows from its figures; pictures by
another method, or judged by another figure, say nothing.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.ended_as_asked import AS_ASKED, status_word
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.acquisition.recording.recording import Recording
from nlos.live.goal import Figures, Goal

KIND = "until"
_LOOK = re.compile(r"the picture of (\d+) points(?: by (.+))? is (good enough|not good enough yet): (.*), level (\S+)")
_FIGURES = {"change": "change", "error": "photon noise", "bound": "error below"}


def look_text(samples: int, method: str, enough: bool, said: str) -> str:
    """The line of one look; `said` ends with the level."""
    verdict = "is good enough" if enough else "is not good enough yet"
    return f"the picture of {samples} points by {method} {verdict}: {said}"


@dataclass(frozen=True)
class Look:
    """One picture of the first `samples` samples. `enough`: for the goal that is asked for now."""

    samples: int
    enough: bool
    bound: float | None
    said: str


def looks_before(recording: Recording, goal: Goal, method: str) -> list[Look]:
    """Of pictures by `method`, what `goal` makes of them, in order."""
    held = len(recording.intact_records())
    found = []
    for event in recording.events():
        line = _LOOK.fullmatch(event.text) if event.kind == KIND else None
        if line is None or line[2] not in (method, None) or not 0 < int(line[1]) <= held:
            continue
        figures = _figures(line[4])
        if goal.can_judge(figures):
            # At the level of then, what was said then: the figures are rounded.
            same = line[5] == f"{goal.level:g}"
            enough = line[3] == "good enough" if same else goal.verdict(figures)[0]
            found.append(Look(int(line[1]), enough, figures["bound"], f"{line[4]}, level {goal.level:g}"))
    return found


def ended_before(run: Path, plan: ScanPlan, goal: Goal, method: str) -> Look | None:
    """The look that ended the scan at `run`, where it was to end by such a goal, and did; None where something is left
    to take, and for a file that is not there or cannot be read: resuming says what is wrong with it."""
    try:
        with open_checked(run) as recording:
            if recording.plan != plan or status_word(recording) != AS_ASKED:
                return None
            return ending(recording, looks_before(recording, goal, method))
    except (FileNotFoundError, InvalidData):
        return None


def ending(recording: Recording, looks: Sequence[Look]) -> Look | None:
    """Which of these ended the scan; None where none did, or it ended its first pass alone."""
    plan, taken = recording.plan, recording.photons()
    numbers, yes = list(taken), [each for each in looks if each.enough]
    if not yes:
        return None
    cuts = plan.revisit_below is not None and plan.pass_[numbers[yes[0].samples - 1]] == 0
    if not cuts:
        return yes[0]
    return yes[1] if yes[1:] else None if plan.pending(taken, first_pass_cut=True) else yes[0]


def _figures(said: str) -> Figures:
    values = {name: re.search(rf"{words} ([0-9.]+)", said) for name, words in _FIGURES.items()}
    return {name: None if value is None else float(value[1]) for name, value in values.items()}
