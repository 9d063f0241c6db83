"""`nlos scan`: acquires a plan on a bench into a recording that nothing can take away."""

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.cli.benches import load_bench
from nlos.cli.contradictions import refuse_together, refuse_without
from nlos.cli.exit_codes import UsageError
from nlos.cli.file_words import Response
from nlos.cli.method_settings import Weights, chosen_method
from nlos.cli.named_files import BenchWord, ScanWord
from nlos.cli.taking import ScanOptions, require_shutter, take
from nlos.configs.load import load
from nlos.live.goal import SURE, parse_until
from nlos.live.good_enough import check_sure
from nlos.live.process import check_pages, methods_for
from nlos.recon.methods import find
from nlos.response import response_wanted
from nlos.run_defaults import dated_name, hooks_for, notes_for
from nlos.series.sweep import swept
from nlos.telling import told


def scan(
    scan: ScanWord,
    bench: BenchWord = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="RUN.h5",
            help="Default: day, time and sample, in the data folder. With --sweep: a folder.",
        ),
    ] = None,
    reconstruct: Annotated[str | None, typer.Option(metavar="METHOD", help="Method name; see `nlos methods`.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Acquire only what is missing.")] = False,
    scene: Annotated[
        Path | None, typer.Option(metavar="RUN.h5", help="Replay a recorded scan as the simulated bench's light.")
    ] = None,
    constants: Annotated[
        Path | None,
        typer.Option(
            metavar="CONSTANTS.h5", help="Constants to aim and to correct by, or none. Default: the bench's newest."
        ),
    ] = None,
    no_shutter: Annotated[bool, typer.Option("--no-shutter", help="Allow a bench without a shutter.")] = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show the scan on a read-only page, served by a separate process.")
    ] = False,
    until: Annotated[
        str | None,
        typer.Option(
            metavar="sure[:LEVEL]|stable[:LEVEL]",
            help="Stop (or start the second pass) once the picture's error is below LEVEL in nine cases of ten, or "
            "once it stands still.",
        ),
    ] = None,
    weights: Weights = None,
    response: Response = "auto",
    sample: Annotated[
        str | None, typer.Option(metavar="TEXT", help="What is behind the corner; stored in the recording.")
    ] = None,
    operator: Annotated[str | None, typer.Option(metavar="NAME", help="Who measures.")] = None,
    note: Annotated[str | None, typer.Option(metavar="TEXT", help="Anything worth finding again.")] = None,
    tag: Annotated[list[str] | None, typer.Option(metavar="WORD", help="May be given again; `nlos runs WORD`.")] = None,
    sweep: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=A,B,C", help="A scan for each value of a key: dwell_ms=1,2,4. May be given again."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> int:
    """Acquires. Ctrl-C closes the shutter and pauses; Enter resumes, a second Ctrl-C ends the scan cleanly."""

    wanted, table = load("scan", scan, ScanSettings), load_bench(bench)
    require_shutter(table, no_shutter)
    notes = notes_for(table.settings, sample, operator, note, tag or [])
    if sweep:
        refuse_together(
            "--sweep",
            {"--resume": resume, "--live": live, "--until": until is not None, "--scene": scene is not None,
             "--overwrite": overwrite, "--weights": weights is not None, "--response": response != "auto"},
            "it makes a series, which knows only -o, --reconstruct, --constants, --no-shutter and notes",
            "Leave these out; the same command resumes a series, `nlos reconstruct` takes the others afterwards.",
        )  # fmt: skip
        options = ScanOptions(notes, reconstruct, constants=constants)
        return swept(wanted, table, sweep, options, output, no_shutter)
    refuse_together(
        "--resume", {"--overwrite": resume and overwrite}, "a recording cannot be both resumed and replaced",
        "Use --resume to keep what it holds, --overwrite to begin again.",
    )  # fmt: skip
    if resume and output is not None and output.exists():
        given = {"sample": sample, "operator": operator, "note": note, "tags": tag}
        _refuse_other_notes(output, {name: getattr(notes, name) for name in given if given[name] is not None})
    seen = reconstruct is not None or weights is not None or live or until is not None
    refuse_without("--response", response != "auto" and not seen, "--reconstruct", "no picture is made")
    seeing: dict[str, object] = {}
    if weights is not None:
        reconstruct, seeing = chosen_method(weights, reconstruct, {})
    if reconstruct is not None:
        find(reconstruct)
    response_wanted(response)
    goal = None if until is None else parse_until(until)
    if goal is not None and wanted.settings.frames != 1:
        raise UsageError(
            f"--until {until}: {wanted.path} is a film (frames: {wanted.settings.frames}), and what moves is never "
            "good enough. Leave it out; Ctrl-C ends a film early."
        )
    if live or (goal is not None and not table.settings.simulated):
        check_pages("--live" if live else "--until")
    if live or goal is not None:
        best = methods_for(reconstruct)[-1]
        if goal is not None and goal.word == SURE:
            check_sure(best, seeing.get("weights"))
    target = output or dated_name(table.settings, wanted.path.stem, notes.sample, datetime.now())
    if output is None:
        target.parent.mkdir(parents=True, exist_ok=True)
    options = ScanOptions(notes, reconstruct, seeing, resume, scene, constants, live, goal, overwrite, response)
    with told(hooks_for(table.settings), target, notes):
        take(wanted, table, target, options)
    return 0


def _refuse_other_notes(run: Path, said: Mapping[str, object]) -> None:
    """Notes are of a recording's beginning: a resumed one keeps them. Raises `UsageError` for others."""
    try:
        with open_checked(run) as recording:
            held = recording.header.notes
    except InvalidData:  # nothing can be resumed of it: a new recording is begun, with these notes
        return
    for name, value in said.items():
        kept = getattr(held, name)
        if value != kept:
            raise UsageError(
                f"--resume: {run} says {name} {kept!r}, not {value!r}, and keeps what it was begun with. Leave it out, "
                "or begin a recording of another name."
            )
