"""`nlos recover`: save what a crash left."""

from pathlib import Path
from typing import Annotated

import typer

from nlos.acquisition.recording.read_by_child import check_recording
from nlos.acquisition.recording.salvage import recover as recover_recording
from nlos.cli.targets import check_place, recording_target, refuse_own_input
from nlos.cli.terminal import terminal


def recover(
    run: Annotated[Path, typer.Argument(metavar="RUN")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="NEW.h5")],
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Copies every intact sample into a new recording; the old file is left as it is."""
    refuse_own_input(recording_target(output), [run], "the recording that is read")
    check_place(output, overwrite)
    check_recording(run)
    output.absolute().parent.mkdir(exist_ok=True)
    samples = recover_recording(run, output, overwrite=overwrite)
    terminal.result(f"{output}: {samples} intact samples", recording=str(output), samples=samples)
