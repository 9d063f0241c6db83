"""What the cables between mirror controller and counter carry, and whether the inputs at their ends stand it.

Settings of a mirror may say `marker_output_v` and `trigger_input`, those of a counter `marker_input_most_v` and
`clock_output`: a device that says nothing is taken for 5 V TTL.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class LevelConflict:
    """A cable that needs something in between."""

    what: str
    remedy: str


def level_conflicts(mirror: Any, counter: Any) -> Iterator[LevelConflict]:
    """What lies between these two instruments' outputs and inputs, unless `levels_converted` says that it is done."""
    if getattr(counter, "levels_converted", False):
        return
    sent_v, most_v = getattr(mirror, "marker_output_v", 0.0), getattr(counter, "marker_input_most_v", None)
    if most_v is not None and sent_v > most_v:
        yield LevelConflict(
            f"markers of the {mirror.model} are {sent_v:g} V, marker inputs of the {counter.model} take {most_v:g} V "
            "at most: is there a divider in each cable?",
            "Put 1 kohm in series and 2 kohm to ground, or a buffer, into each before it is plugged in; then set "
            "levels_converted: true in the counter's block.",
        )
    clock, wanted = getattr(counter, "clock_output", ""), getattr(mirror, "trigger_input", "")
    if clock not in ("", "TTL") and wanted:
        yield LevelConflict(
            f"the pixel clock of the {counter.model} is {clock}, the trigger input of the {mirror.model} wants "
            f"{wanted}: is there a stretcher in its cable?",
            "Put a NIM-to-TTL converter with a pulse stretcher between them; then set levels_converted: true in the "
            "counter's block.",
        )
