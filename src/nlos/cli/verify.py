"""`nlos verify`: is every sample what was measured?"""

from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.exit_codes import ExitCode, Stopped
from nlos.cli.terminal import terminal


def verify(run: Annotated[Path, typer.Argument(metavar="RUN")]) -> None:
    """Checks every sample's checksum; names the bad and the missing ones."""
    from nlos.acquisition.recording.checked import check_recording
    from nlos.acquisition.recording.salvage import verify as verify_recording

    check_recording(run)
    found = verify_recording(run)
    terminal.result(
        f"{run}: {found.status.name.lower()}; {found.written} of {found.planned} points written, "
        f"{len(found.corrupt)} corrupt, {len(found.repeated)} repeated, {len(found.missing)} missing",
        status=found.status.name.lower(), planned=found.planned, written=found.written,
        corrupt=found.corrupt, repeated=found.repeated, missing=found.missing, intact=found.intact,
    )  # fmt: skip
    if not found.intact:
        rows = ", ".join(str(row) for row in (*found.corrupt, *found.repeated)[:10])
        raise Stopped(
            ExitCode.DATA,
            f"{run}: rows {rows} are not what was measured. `nlos recover {run} -o NEW.h5` keeps the others; "
            "`nlos scan ... -o NEW.h5 --resume` takes them again.",
        )
