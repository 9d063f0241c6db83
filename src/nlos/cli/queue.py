"""`nlos queue`: many scans one after the other, forecast whole, resumed after anything."""

from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.terminal import terminal
from nlos.series.carry_out import Series, carry_out, forecast
from nlos.series.sweep import load_queue


def queue(
    file: Annotated[Path, typer.Argument(metavar="FILE.yaml", help="Which scans, and what an alarm does to the rest.")],
    plan: Annotated[bool, typer.Option("--plan", help="Check and forecast all of it; take nothing.")] = False,
    retry: Annotated[bool, typer.Option("--retry", help="Resume what an alarm ended.")] = False,
) -> int:
    """Takes every scan of a queue file. Called again it resumes: after Ctrl-C, an alarm, a full disk, a power cut. What
    is done stays; what was cut off is resumed; recordings, not the journal, have the last word."""
    series = Series.of(load_queue(file), retry)
    if plan:
        forecast(series)
        terminal.document["outcomes"] = {}
        return 0
    return carry_out(series)
