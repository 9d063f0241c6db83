"""`nlos verify`: is every sample what was measured?"""

from pathlib import Path
from typing import Annotated

import typer

from nlos.acquisition.recording.condition import listed
from nlos.acquisition.recording.read_by_child import check_recording
from nlos.acquisition.recording.verification import verify as verify_recording
from nlos.cli.exit_codes import ExitCode, Stopped
from nlos.cli.terminal import terminal


def verify(run: Annotated[Path, typer.Argument(metavar="RUN")]) -> None:
    """Checks every sample's checksum. Exits 0 where every planned sample is there, and what was measured;
    of a scan that ended as asked, every one that was taken."""
    check_recording(run)
    found = verify_recording(run)
    rows = found.rows
    terminal.result(
        f"{run}: {found.status_word}; {rows.intact} of {found.planned} points are what was measured, "
        f"{len(rows.damaged)} damaged, {len(rows.unread)} unreadable, {len(found.repeated)} repeated, "
        f"{len(found.missing)} missing, {len(rows.unacknowledged)} never acknowledged",
        status=found.status_word, planned=found.planned, written=found.written, intact_samples=rows.intact,
        corrupt=rows.damaged, unread=rows.unread, unacknowledged=rows.unacknowledged, repeated=found.repeated,
        missing=found.missing, intact=found.intact, complete=found.complete, full=rows.full,
    )  # fmt: skip
    if found.frames > 1:
        terminal.result(
            f"  frames: {found.complete_frames} of {found.frames} are complete",
            frames=found.frames, complete_frames=found.complete_frames,
        )  # fmt: skip
    named = {
        "rows that are not what was measured": rows.damaged,
        "rows that the disk cannot read": rows.unread,
        "rows that were never acknowledged": rows.unacknowledged,
        "points taken twice": found.repeated,
        "missing points": found.missing,
    }
    for what, numbers in named.items():
        if numbers:
            terminal.result(f"  {what}: {listed(numbers, 16)}")
    if rows.full:
        terminal.log(
            f"warning: {run}: {rows.full_words}. Scan these points anew, with a shorter dwell_ms or less light."
        )
    if found.complete:
        return
    if found.as_asked and found.intact:
        terminal.result("  the picture was good enough without them; `nlos scan ... --resume` takes them all the same")
        return
    if rows.damaged or found.repeated:
        code, what, remedy = ExitCode.DATA, "not every sample is what was measured", "keeps the others"
    elif rows.unread:
        code, what, remedy = ExitCode.STORAGE, "not every sample can be read", "keeps the others"
    else:
        code, what, remedy = ExitCode.DATA, f"{len(found.missing)} planned points are missing", "keeps what is there"
    raise Stopped(
        code, f"{run}: {what}. `nlos scan ... -o {run} --resume` takes what is missing; "
        f"`nlos recover {run} -o NEW.h5` {remedy}.",
    )  # fmt: skip
