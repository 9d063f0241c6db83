"""`nlos replay`: recorded samples through the same path as a live scan."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from nlos.acquisition.recording.ended_as_asked import KIND
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.replay import replay as play
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.advice import REASON
from nlos.chain import reconstruct_file
from nlos.cli.contradictions import refuse_without
from nlos.cli.escaped import escaped
from nlos.cli.exit_codes import UsageError
from nlos.cli.file_words import Response
from nlos.cli.method_settings import Weights, chosen_method
from nlos.cli.picture_beside import picture_beside
from nlos.cli.progress import Progress
from nlos.cli.targets import check_place, recording_target, refuse_own_input
from nlos.cli.terminal import terminal
from nlos.recipe import Recipe
from nlos.recon.methods import find
from nlos.recon.results import files_in
from nlos.response import response_wanted
from nlos.results_folder import ResultsFolder


def replay(
    run: Annotated[Path, typer.Argument(metavar="RUN")],
    speed: Annotated[str, typer.Option(metavar="X", help="Multiple of the recorded pace; `max` does not wait.")] = "1",
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="NEW.h5")] = None,
    reconstruct: Annotated[
        str | None, typer.Option(metavar="METHOD", help="Name (see `nlos methods`) or a file of your own, ./mine.py.")
    ] = None,
    weights: Weights = None,
    response: Response = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Plays the samples of a recording, into a new recording and a picture where asked for."""
    pace = _pace(speed)
    settings: dict[str, object] = {}
    if weights is not None:
        reconstruct, settings = chosen_method(weights, reconstruct, {})
    refuse_without("--response", response != "auto" and reconstruct is None, "--reconstruct", "no picture is made")
    if reconstruct is not None:  # before anything is written
        find(reconstruct)
        response_wanted(response)
    if output is not None:
        refuse_own_input(recording_target(output), [run], "the recording that is replayed")
        check_place(output, overwrite)
    if reconstruct is not None:
        picture_beside(
            output or run, overwrite, "Choose another name with -o, use --overwrite, or leave --reconstruct out."
        )
    with open_checked(run) as recording:
        warning, left_aside = recording.condition().warning, recording.left_aside()
        writer = None
        if output is not None:
            output.parent.mkdir(exist_ok=True)
            name, began = escaped(run.name), recording.header.started_utc
            said = f"replayed from {name}, measured {began}: no new measurement was made"
            warnings = (*recording.header.warnings, said)
            header = replace(recording.header, identity="", warnings=warnings)  # a recording of its own
            writer = RecordingWriter.create(output, recording.plan, header, overwrite=overwrite)
            writer.log("replayed", said)
            for event in recording.events():
                if event.kind == REASON and not left_aside:  # else they are not the samples of which it is said
                    writer.log(event.kind, event.text, event.bench_s)
            if left_aside:
                writer.log("left_aside", f"{name}: {warning}")
        samples, photons, whole = 0, 0, False
        with Progress(len(recording), what="replay") as progress:
            try:
                for sample in play(recording, pace):
                    samples += 1
                    photons += sample.histogram.total_count
                    if writer is not None:
                        writer.write(sample)
                    progress.step()
                whole = True
            finally:
                if writer is not None:
                    _end(writer, recording, whole)
    terminal.result(
        f"{output or run}: {samples} samples, {photons} photons replayed",
        recording=str(output or run), samples=samples, photons=photons, left_aside=left_aside,
    )  # fmt: skip
    if reconstruct is not None:
        folder = (output or run).with_suffix("")
        recipe = Recipe(reconstruct, settings, response=response_wanted(response))
        reconstruct_file(output or run, recipe, ResultsFolder(folder, overwrite=overwrite))
        names = files_in(folder)
        terminal.result(f"{folder}: {', '.join(names)}", folder=str(folder), files=names)


def _end(writer: RecordingWriter, recording: Recording, whole: bool) -> None:
    """Ends the new recording as the one that was replayed `whole` had ended, with what it says of its end."""
    if not whole:
        writer.finish(Status.INTERRUPTED)
        return
    if not recording.left_aside():  # else it does not hold what that scan ended with
        for event in recording.events():
            if event.kind == KIND:
                writer.log(event.kind, event.text, event.bench_s)
    ended = Status.INTERRUPTED if recording.missing() else Status.COMPLETE
    writer.finish(ended if recording.status in (Status.RUNNING, Status.COMPLETE) else recording.status)


def _pace(word: str) -> float | None:
    if word == "max":
        return None
    try:
        pace = float(word)
    except ValueError:
        pace = 0.0
    if not 0 < pace <= 1e6:
        raise UsageError(f"--speed {word}: a number above 0, or max")
    return pace
